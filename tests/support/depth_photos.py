"""Photographs with a depth map inside, as telephones and programs write them: Dynamic Depth and
GDepth, in every spelling of XMP.
"""

import base64
import hashlib
from collections.abc import Mapping, Sequence

NOTE, HEAD = b"http://ns.adobe.com/xmp/extension/\0", b"http://ns.adobe.com/xap/1.0/\0"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
GOOGLE = "http://ns.google.com/photos/"


def document(body: str, attributes: str = "") -> str:
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="{RDF}">'
        f'<rdf:Description rdf:about="" {attributes}>{body}</rdf:Description></rdf:RDF></x:xmpmeta>'
    )


def with_xmp(jpeg: bytes, xmp: str, extended: bool = False) -> bytes:
    """A JPEG with XMP. extended: in segments after a short packet that names them."""
    parts = [HEAD + xmp.encode()]
    if extended:
        data = xmp.encode()
        name = hashlib.md5(data).hexdigest().upper()
        note = f'xmlns:n="http://ns.adobe.com/xmp/note/" n:HasExtendedXMP="{name}"'
        parts = [HEAD + document("", note).encode()]
        for at in range(0, len(data), 1000):
            head = name.encode() + len(data).to_bytes(4) + at.to_bytes(4)
            parts.insert(1, NOTE + head + data[at : at + 1000])  # in any order
    segments = b"".join(b"\xff\xe1" + (len(part) + 2).to_bytes(2) + part for part in parts)
    return jpeg[:2] + segments + jpeg[2:]


def element(name: str, fields: dict[str, object], apart: bool) -> str:
    """An element with fields as attributes, or as elements of their own."""
    if not apart:
        inner = " ".join(f'{key}="{value}"' for key, value in fields.items())
        return f"<{name} {inner}/>"
    inner = "".join(f"<{key}>{value}</{key}>" for key, value in fields.items())
    return f'<{name} rdf:parseType="Resource">{inner}</{name}>'


def dynamic_depth(
    jpeg: bytes,
    items: Sequence[tuple[str, bytes]],
    apart: bool = False,
    prefix: str = "",
    extended: bool = False,
    uris: bool = False,
    stated: Mapping[str, object] | None = None,
    lengths: bool = True,
) -> bytes:
    """A photograph and items of (kind, data) behind it. prefix: before those of all namespaces;
    uris: the map is found by its address, not by the item's kind.
    """
    item, depth = f"{prefix}Item", f"{prefix}DepthMap"
    version = "dd/1.0" if uris else "1.0/container"
    spaces = {item: f"{GOOGLE}{version}/item/", depth: f"{GOOGLE}dd/1.0/depthmap/"}
    spaces |= {f"{prefix}Device": f"{GOOGLE}dd/1.0/device/", f"{prefix}C": f"{GOOGLE}{version}/"}
    listed = []
    for kind, data in [("Primary", b""), *items]:
        fields: dict[str, object] = {f"{item}:Mime": "image/jpeg"}
        fields |= {f"{item}:Length": len(data) if lengths else 0}
        fields |= {f"{item}:DataURI" if uris else f"{item}:Semantic": kind}
        listed.append("<rdf:li>" + element(f"{prefix}C:Item", fields, apart) + "</rdf:li>")
    about = {f"{depth}:{key}": value for key, value in (stated or {}).items()}
    if uris:
        about |= {f"{depth}:DepthURI": "Depth"}
    body = f"<{prefix}C:Directory><rdf:Seq>{''.join(listed)}</rdf:Seq></{prefix}C:Directory>"
    body += element(f"{prefix}Device:Map", about, apart) if about else ""
    names = " ".join(f'xmlns:{name}="{space}"' for name, space in spaces.items())
    return with_xmp(jpeg, document(body, names), extended) + b"".join(data for _, data in items)


def gdepth(
    jpeg: bytes,
    depth: bytes,
    stated: Mapping[str, object],
    apart: bool = False,
    prefix: str = "GDepth",
) -> bytes:
    """A photograph with a depth map in its XMP, as before Android 10."""
    fields = {"Mime": "image/png", "Data": base64.b64encode(depth).decode(), **stated}
    named = {f"{prefix}:{key}": value for key, value in fields.items()}
    space = f'xmlns:{prefix}="{GOOGLE}1.0/depthmap/" xmlns:o="{GOOGLE}1.0/image/" o:Data="x"'
    if apart:
        body = "".join(f"<{key}>{value}</{key}>" for key, value in named.items())
        return with_xmp(jpeg, document(body, space), extended=True)
    inner = " ".join(f'{key}="{value}"' for key, value in named.items())
    return with_xmp(jpeg, document("", f"{space} {inner}"), extended=True)
