"""Pictures drawn by a GPU through OpenGL, without a window: any display shows them. Needs the extra
`gpu`. An entry point of `lfpipe.painters`.

Views near the eyes are uploaded when first drawn and kept while they fit. The GPU's thread alone
uses its context; others wait for its pictures.
"""

import logging
import math
import re
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from typing import Any, TypeVar

import attrs
import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.extras.gpu.shader import disparity_texels, mixture, source
from lfpipe.host.worker import has_gpu
from lfpipe.render.synthesis.anaglyph import Recipe
from lfpipe.render.synthesis.compositor import PainterLost
from lfpipe.render.synthesis.engine import Cameras
from lfpipe.render.synthesis.scene_views import SceneViews, size_of
from lfpipe.render.synthesis.viewpoint import Position
from lfpipe.render.synthesis.warper import LEVELS

logger = logging.getLogger(__name__)
T = TypeVar("T")

BUDGET_BYTES = 256 << 20  # of the GPU's memory: all 81 views of a usual field, 12 of 1920x1080
MIN_LAYERS = 8  # four views for each eye
MAX_LAYERS = 256  # of a texture, which every OpenGL 3.3 allows
SOFTWARE = re.compile(r"llvmpipe|softpipe|swiftshader|software|basic render", re.IGNORECASE)
VERTICES = """#version 330 core
out vec2 at;
void main() {
  at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  gl_Position = vec4(2.0 * at - 1.0, 0.0, 1.0);
}
"""


class Gpu:
    """`Painters`: an OpenGL context and the program that draws. thread: of its own."""

    def __init__(self, thread: Executor) -> None:
        """Raises ImportError without the extra, and PainterLost if there is no context."""
        import moderngl

        self._thread = thread
        self.context: Any = None
        self._errors = moderngl.Error
        self.failure = ""
        """Why it draws no longer."""
        self.name: str = self.run(self._open)
        """Of the renderer."""

    def _open(self) -> str:
        import moderngl

        backend: dict[str, Any] = {"backend": "egl"} if sys.platform == "linux" else {}
        try:
            self.context = moderngl.create_context(standalone=True, require=330, **backend)
        except Exception as error:  # glcontext raises plain ones
            raise moderngl.Error(str(error)) from None
        self.context.gc_mode = "context_gc"
        self.program: Any = self.context.program(VERTICES, f"#version 330 core\n{source()}")
        self.program["disparities"].value = 1
        self.quad = self.context.vertex_array(self.program, [])
        return str(self.context.info["GL_RENDERER"])

    def painter(self, views: SceneViews, method: str, mix: Recipe) -> "ShaderPainter":
        """See `Painters`."""
        return ShaderPainter(self, views, method, mix)

    def run(self, work: Callable[..., T], *arguments: Any) -> T:
        """Does work in the GPU's thread. Raises PainterLost."""
        if self.failure:
            raise PainterLost(self.failure)
        try:
            return self._thread.submit(work, *arguments).result()
        except (self._errors, PainterLost) as error:
            self.failure = str(error).strip().partition("\n")[0] or "its context was lost"
            logger.exception("the GPU draws no longer")
            raise PainterLost(self.failure) from None


def open_gpu(asked: str, thread: Executor) -> tuple[Gpu | None, str]:
    """The GPU for render.device = asked, or None, and what draws, for people.

    "auto" accepts no OpenGL in software, which is slower than the processor's own way.
    """
    if asked == "cpu" or (asked == "auto" and not has_gpu()):
        return None, "CPU" if asked == "cpu" else "CPU: no GPU found"
    try:
        gpu = Gpu(thread)
    except ImportError:
        return None, "CPU: the extra gpu is not installed"
    except PainterLost as error:
        return None, f"CPU: no OpenGL 3.3 ({error})"
    if asked == "auto" and SOFTWARE.search(gpu.name):
        gpu.run(gpu.context.release)
        return None, f"CPU: OpenGL in software ({gpu.name})"
    return gpu, f"GPU: {gpu.name}"


@attrs.frozen(eq=False, kw_only=True)
class _Textures:
    """The layers of one size of pictures; made and used in the GPU's thread."""

    views: Any
    disparities: Any
    target: Any  # framebuffer
    layers: dict[tuple[int, int, int], int] = attrs.field(factory=dict)  # the last used at the end


class ShaderPainter:
    """Draws warped pictures with the shader: a `Painter`."""

    def __init__(self, gpu: Gpu, views: SceneViews, method: str, mix: Recipe) -> None:
        """Raises PainterLost."""
        self._gpu = gpu
        self._views = views
        self._method = method
        self._cameras = Cameras(views.field)
        self._mixture = mixture(mix)
        self._eyes = sorted({plane.eye for plane in mix.planes})
        self._pixels = np.zeros((views.height_px, views.width_px, 4), np.uint8)
        self._textures = gpu.run(self._make_textures)

    def _make_textures(self) -> _Textures:
        context, field = self._gpu.context, self._views.field
        context.gc()
        size_px = self._views.width_px, self._views.height_px
        rows, cols = size_of(size_px[1], size_px[0])
        fit = BUDGET_BYTES // (4 * math.prod(size_px))  # a GPU pads red, green and blue
        count = min(max(fit, MIN_LAYERS), MAX_LAYERS, field.frames * field.rows * field.cols)
        views, disparities = (
            context.texture_array((*size, count), 3, alignment=1)
            for size in (size_px, (cols, rows))
        )
        for texture in (views, disparities):
            texture.repeat_x = texture.repeat_y = False
        target = context.framebuffer([context.renderbuffer(size_px, 4)])
        return _Textures(views=views, disparities=disparities, target=target)

    def reset(self) -> None:
        """See `Painter`."""
        self._cameras = Cameras(self._views.field)
        self._textures.layers.clear()

    def paint(
        self,
        frame: int,
        eyes: Sequence[Position],
        zero_px: float,
        out: NDArray[np.uint8],
        alone: bool = False,
    ) -> None:
        """See `Painter`. Raises PainterLost."""
        self._gpu.run(self._draw, frame, eyes, zero_px)
        cv2.cvtColor(self._pixels, cv2.COLOR_RGBA2BGR, dst=out)

    def _draw(self, frame: int, eyes: Sequence[Position], zero_px: float) -> None:
        views, textures, program = self._views, self._textures, self._gpu.program
        field = views.field
        sights, fades = np.zeros((2, 8, 4), np.float32)
        shift = np.zeros((2, 2), np.float32)
        for eye in self._eyes:
            shift[eye] = self._cameras.shift_px(zero_px, eyes[eye])[::-1]
            for k, view in enumerate(self._cameras.weights(self._method, eyes[eye], eye), 4 * eye):
                steps = self._cameras.steps(view, eyes[eye], eye)
                sights[k] = self._layer(frame, view.row, view.col), view.weight, *steps[::-1]
            for k, view in enumerate(self._cameras.weights("blend", eyes[eye], eye), 4 * eye):
                by = np.rint(self._cameras.shift_px(zero_px, (view.row, view.col)))
                fades[k] = self._layer(frame, view.row, view.col), view.weight, *by[::-1]
        for name, values in (("sights", sights), ("fades", fades), ("shift", shift)):
            program[name].write(values.tobytes())
        uniforms: dict[str, Any] = {
            **self._mixture,
            "size": (views.width_px, views.height_px),
            "unit": abs(field.disparity_scale_px) * views.scale,
            "span": (field.disparity_max_px - field.disparity_min_px) * views.scale,
        }
        for name, value in uniforms.items():
            program[name].value = value
        textures.views.use(0)
        textures.disparities.use(1)
        textures.target.use()
        self._gpu.quad.render(mode=self._gpu.context.TRIANGLE_STRIP, vertices=4)
        self._pixels[0, 0, 3] = 0
        textures.target.read_into(self._pixels, components=4, alignment=1)
        # commands of a lost context have no effect, and report none
        if self._pixels[0, 0, 3] == 0 or self._gpu.context.error != "GL_NO_ERROR":
            raise PainterLost("its context was lost")

    def _layer(self, frame: int, row: int, col: int) -> int:
        """The layer of a view, uploaded if it is not there, in place of the one unused longest."""
        textures, views = self._textures, self._views
        key = frame, row, col
        layer = textures.layers.pop(key, None)
        if layer is None:
            full = len(textures.layers) == textures.views.layers
            layer = (
                textures.layers.pop(next(iter(textures.layers))) if full else len(textures.layers)
            )
            planes = [views.channel(k)(*key) for k in range(views.field.channels)]
            levels_of = LEVELS[views.field.disparity_scale_px < 0][1]
            levels = cv2.LUT(views.disparity(*key).view(np.uint8), levels_of)
            for texture, texels in (
                (textures.views, cv2.merge(planes * (3 // len(planes)))),
                (textures.disparities, disparity_texels(np.asarray(levels, np.uint8))),
            ):
                texture.write(texels, viewport=(0, 0, layer, texels.shape[1], texels.shape[0], 1))
        textures.layers[key] = layer
        return layer
