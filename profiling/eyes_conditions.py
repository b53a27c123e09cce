"""Found and kept faces, and accuracy of the eyes, by condition.

    python -m profiling.eyes_conditions FACES [--engine mediapipe]

FACES holds imm/*.jpg and eyes_truth.csv. Three portraits of each person, one frontal and two
turned, are put into pictures of 640x480, eyes 63 px apart where nothing else is said, and painted
over. first: share of the portraits found in the first picture. 9: in one of the first nine, all the
same. kept: still followed in the ninth of nine pictures that come after six of the same portrait
unspoilt; of a leaning head, after it has leant by 5 degrees a picture. wrong: share of the faces
taken at any time whose eyes are off by more than a quarter of their distance. NME: mean error of
both eyes in their distance, against the contour of the lids, of those found within nine. shift: how
far the condition moves the eyes of the unspoilt portrait, in % of their distance.
"""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from lfpipe.track.engine import MediapipeEngine
from lfpipe.track.litert_engine import LitertEngine
from profiling.arguments import existing, parser_of, start

Picture = NDArray[np.uint8]
Float = NDArray[np.float64]
Colour = tuple[int, int, int]
Paint = Callable[[Picture, float], Picture]  # of a picture whose eyes are so many px apart
WIDTH, HEIGHT = 640, 480
MIDDLE = np.array([320.0, 200.0])  # between the eyes
EYE_DISTANCE_PX = 63.0
KINDS = "134"  # of portrait: frontal, turned to either side
LOOKS, LEAD = 9, 6
WRONG = 0.25
NAMES = ("subject_left_x", "subject_left_y", "subject_right_x", "subject_right_y")
SKIN_AT = (0.0, 0.35)  # on the nose; places are in distances between the eyes, from MIDDLE
BLACK: Colour = (25, 25, 25)
RIGHT, LEFT = (-0.5, 0.0), (0.5, 0.0)  # the person's own eyes


def pixel(place: tuple[float, float], eye_distance_px: float) -> tuple[int, int]:
    x, y = MIDDLE + eye_distance_px * np.array(place)
    return round(x), round(y)


def covered(
    place: tuple[float, float], half: tuple[float, float], colour: Colour | None, soft: float = 0.02
) -> Paint:
    """An ellipse; colour None: of the skin."""

    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        mask = np.zeros(picture.shape[:2], np.float32)
        axes = round(half[0] * eye_distance_px), round(half[1] * eye_distance_px)
        cv2.ellipse(mask, pixel(place, eye_distance_px), axes, 0, 0, 360, 1.0, -1)
        x, y = pixel(SKIN_AT, eye_distance_px)
        skin = picture[y - 3 : y + 4, x - 3 : x + 4].mean(axis=(0, 1))
        return blended(
            picture, skin if colour is None else np.array(colour), mask, soft * eye_distance_px
        )

    return paint


def filled(corners: list[tuple[float, float]], colour: Colour, soft: float = 0.02) -> Paint:
    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        mask = np.zeros(picture.shape[:2], np.float32)
        cv2.fillPoly(mask, [np.array([pixel(place, eye_distance_px) for place in corners])], 1.0)
        return blended(picture, np.array(colour), mask, soft * eye_distance_px)

    return paint


def blended(picture: Picture, colour: Float, mask: NDArray[np.float32], soft_px: float) -> Picture:
    share = cv2.GaussianBlur(mask, (0, 0), max(soft_px, 0.3))[..., None]
    return np.asarray(picture + share * (colour - picture), np.uint8)


def drawn(*lines: tuple[tuple[float, float], tuple[float, float]], width: float = 0.06) -> Paint:
    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        out = picture.copy()
        for begin, end in lines:
            ends = pixel(begin, eye_distance_px), pixel(end, eye_distance_px)
            cv2.line(out, *ends, BLACK, max(round(width * eye_distance_px), 1), cv2.LINE_AA)
        return out

    return paint


def rims(width: float) -> Paint:
    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        out = picture.copy()
        axes = round(0.38 * eye_distance_px), round(0.27 * eye_distance_px)
        for place in (RIGHT, LEFT):
            at = pixel((place[0], 0.04), eye_distance_px)
            cv2.ellipse(out, at, axes, 0, 0, 360, BLACK, max(round(width * eye_distance_px), 1))
        return drawn(((-0.12, 0.0), (0.12, 0.0)), width=width)(out, eye_distance_px)

    return paint


def filters(picture: Picture, eye_distance_px: float) -> Picture:
    """Red before the person's left eye, cyan before the right one."""
    out = picture.astype(np.float32)
    for place, light in ((LEFT, (0.1, 0.12, 0.75)), (RIGHT, (0.7, 0.65, 0.06))):
        x0, y0 = pixel((place[0] - 0.4, -0.24), eye_distance_px)
        x1, y1 = pixel((place[0] + 0.4, 0.32), eye_distance_px)
        out[y0:y1, x0:x1] *= np.array(light, np.float32)
    return rimmed(out.astype(np.uint8), eye_distance_px)


def rimmed(picture: Picture, eye_distance_px: float) -> Picture:
    """The white card that film glasses are made of."""
    out = picture.copy()
    for x, _ in (RIGHT, LEFT):
        low, high = (
            pixel((x - 0.42, -0.26), eye_distance_px),
            pixel((x + 0.42, 0.34), eye_distance_px),
        )
        cv2.rectangle(out, low, high, (225, 230, 230), max(round(0.08 * eye_distance_px), 1))
    return out


def lenses(scale: float) -> Paint:
    """Glasses that show the eyes so much larger."""

    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
        for place in (RIGHT, LEFT):
            cx, cy = MIDDLE + eye_distance_px * np.array(place)
            inside = np.hypot((x - cx) / 0.4, (y - cy) / 0.3) < eye_distance_px
            x = np.where(inside, cx + (x - cx) / scale, x)
            y = np.where(inside, cy + (y - cy) / scale, y)
        bent = cv2.remap(picture, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
        return rims(0.04)(np.asarray(bent, np.uint8), eye_distance_px)

    return paint


def glare(picture: Picture, eye_distance_px: float) -> Picture:
    for x in (-0.6, 0.4):
        bar = [(x, -0.2), (x + 0.2, -0.2), (x + 0.1, 0.25), (x - 0.1, 0.25)]
        picture = filled(bar, (250, 250, 250), 0.05)(picture, eye_distance_px)
    return rims(0.04)(picture, eye_distance_px)


def mask_of(colour: Colour, shaded: bool, top: float = 0.42) -> Paint:
    """A mask before mouth and nose, with or without light, shade, pleats and straps."""
    outline = [(-0.85, 0.6), (-0.15, top), (0.15, top), (0.85, 0.6), (0.7, 1.45), (0.3, 1.75)]
    outline += [(-0.3, 1.75), (-0.7, 1.45)]

    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        out = filled(outline, colour, 0.01)(picture, eye_distance_px)
        if not shaded:
            return out
        y, x = (np.mgrid[:HEIGHT, :WIDTH] - MIDDLE[::-1, None, None]) / eye_distance_px
        light = 1.0 - 0.35 * np.square(x / 0.85) + 0.12 * np.exp(-np.square(x / 0.15))
        for pleat in (0.85, 1.05, 1.25):
            light = light - 0.18 * np.exp(-np.square((y - pleat) / 0.02))
        inside = (np.abs(out.astype(int) - picture).sum(axis=2, keepdims=True) > 0).astype(float)
        out = np.clip(out * (1 + inside * (light[..., None] - 1)), 0, 255).astype(np.uint8)
        return drawn(((-0.85, 0.6), (-1.2, 0.1)), ((0.85, 0.6), (1.2, 0.1)), width=0.03)(
            out, eye_distance_px
        )

    return paint


def beard(picture: Picture, eye_distance_px: float) -> Picture:
    y, x = (np.mgrid[:HEIGHT, :WIDTH] - MIDDLE[::-1, None, None]) / eye_distance_px
    share = (np.hypot(x / 0.85, (y - 1.1) / 0.75) < 1) & (y > 0.75)
    share &= np.hypot(x / 0.35, (y - 1.08) / 0.1) > 1
    noise = np.random.default_rng(1).normal(40, 14, (HEIGHT, WIDTH, 1)).clip(5, 90)
    soft = cv2.GaussianBlur(share.astype(np.float32), (0, 0), 0.05 * eye_distance_px)[..., None]
    return np.asarray(picture + 0.85 * soft * (noise - picture), np.uint8)


def hat(picture: Picture, eye_distance_px: float) -> Picture:
    y, x = (np.mgrid[:HEIGHT, :WIDTH] - MIDDLE[::-1, None, None]) / eye_distance_px
    below = (y > -0.5) & (np.abs(x) < 1.1)
    shade = 1 - 0.55 * np.clip((0.55 - y) / 0.4, 0, 1)[..., None] * below[..., None]
    out = np.asarray(picture * shade, np.uint8)
    crown = [(-1.1, -0.45), (-1.0, -1.4), (-0.5, -1.8), (0.5, -1.8), (1.0, -1.4), (1.1, -0.45)]
    out = filled(crown, (60, 45, 40))(out, eye_distance_px)
    brim = [(-1.6, -0.35), (-1.1, -0.6), (1.1, -0.6), (1.6, -0.35), (0.0, -0.42)]
    return filled(brim, (45, 35, 30))(out, eye_distance_px)


def skin(share: float) -> Paint:
    """A face that reflects this share of the light."""

    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        mask = np.zeros(picture.shape[:2], np.float32)
        axes = round(1.15 * eye_distance_px), round(1.65 * eye_distance_px)
        cv2.ellipse(mask, pixel((0.0, 0.45), eye_distance_px), axes, 0, 0, 360, 1.0, -1)
        soft = cv2.GaussianBlur(mask, (0, 0), 0.1 * eye_distance_px)[..., None]
        return np.asarray(picture * (1 + soft * (share - 1)), np.uint8)

    return paint


def dark(share: float) -> Paint:
    """This share of the light, with the noise of its photons."""

    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        few = np.random.default_rng(1).poisson(picture * share * 2.0) / 2.0
        return np.clip(few, 0, 255).astype(np.uint8)

    return paint


def blurred(length_px: int) -> Paint:
    kernel = np.zeros((length_px, length_px), np.float32)
    kernel[length_px // 2] = 1 / length_px
    return lambda picture, eye_distance_px: np.asarray(cv2.filter2D(picture, -1, kernel), np.uint8)


def plain(picture: Picture, eye_distance_px: float) -> Picture:
    return picture


def both(*paints: Paint) -> Paint:
    def paint(picture: Picture, eye_distance_px: float) -> Picture:
        for one in paints:
            picture = one(picture, eye_distance_px)
        return picture

    return paint


def closed(*places: tuple[float, float]) -> Paint:
    lids = [covered(place, (0.24, 0.13), None, 0.05) for place in places]
    lashes = drawn(*(((x - 0.18, y + 0.06), (x + 0.18, y + 0.06)) for x, y in places), width=0.03)
    return both(*lids, lashes)


def sunglasses(picture: Picture, eye_distance_px: float) -> Picture:
    for x, y in (RIGHT, LEFT):
        picture = covered((x, y + 0.04), (0.38, 0.27), BLACK)(picture, eye_distance_px)
    return drawn((RIGHT, LEFT))(picture, eye_distance_px)


class Condition(NamedTuple):
    name: str
    paint: Paint
    eye_distance_px: float = EYE_DISTANCE_PX
    lean_deg: float = 0.0


FINGERS = [covered((0.3 + 0.16 * k, 0.0), (0.09, 0.6), None, 0.01) for k in range(4)]
EDGES = drawn(*(((0.38 + 0.16 * k, -0.5), (0.38 + 0.16 * k, 0.5)) for k in range(3)), width=0.015)
BLUE, WHITE, DARK = (190, 165, 120), (225, 225, 225), (35, 35, 35)
MASK = mask_of(BLUE, shaded=True)
CONDITIONS = (
    Condition("as it is", plain),
    Condition("one eye closed", closed(LEFT)),
    Condition("both eyes closed", closed(LEFT, RIGHT)),
    Condition("eye patch", both(covered(LEFT, (0.33, 0.27), BLACK), drawn(((-0.9, -0.7), LEFT)))),
    Condition("hand before one eye", both(*FINGERS, EDGES)),
    Condition(
        "half of the face covered", filled([(0, -1.6), (1.8, -1.6), (1.8, 2), (0, 2)], (90, 80, 70))
    ),
    Condition("sunglasses", sunglasses),
    Condition("thick frames", rims(0.1)),
    Condition("glasses with glare", glare),
    Condition("strong minus lenses (0.8)", lenses(0.8)),
    Condition("strong plus lenses (1.25)", lenses(1.25)),
    Condition("red-cyan glasses", filters),
    Condition("beard", beard),
    Condition("hat, shaded eyes", hat),
    Condition("hat, beard, sunglasses", both(beard, sunglasses, hat)),
    Condition("flat mask", mask_of(BLUE, shaded=False)),
    Condition("shaded mask, blue", MASK),
    Condition("shaded mask, white", mask_of(WHITE, shaded=True)),
    Condition("shaded mask, black", mask_of(DARK, shaded=True)),
    Condition("mask up to the lids", mask_of(BLUE, shaded=True, top=0.2)),
    Condition("mask, thick frames", both(MASK, rims(0.1))),
    Condition("mask, hat", both(MASK, hat)),
    Condition("mask, red-cyan glasses", both(MASK, filters)),
    Condition("mask, hat, red-cyan glasses", both(MASK, filters, hat)),
    Condition("dark skin (0.4)", skin(0.4)),
    Condition("dark skin, 20 % of the light", both(skin(0.4), dark(0.2))),
    Condition("dark skin, 8 % of the light", both(skin(0.4), dark(0.08))),
    Condition("5 % of the light", dark(0.05)),
    Condition("1.5 m away", plain, 25.2),
    Condition("3 m away", plain, 12.6),
    Condition("motion blur of 21 px", blurred(21)),
    Condition("motion blur of 41 px", blurred(41)),
    Condition("leans by 45 degrees", plain, lean_deg=45),
    Condition("leans by 75 degrees", plain, lean_deg=75),
    Condition("leans by 85 degrees", plain, lean_deg=85),
    Condition("lies, 90 degrees", plain, lean_deg=90),
)


class Portrait(NamedTuple):
    head: Picture
    eyes: Float  # (2, 2): the person's left and right one, px

    def placed(self, eye_distance_px: float, lean_deg: float = 0.0) -> tuple[Picture, Float]:
        """A picture with the head in it, and its eyes there."""
        head = self.head
        between, middle = self.eyes[0] - self.eyes[1], self.eyes.mean(axis=0)
        scale = eye_distance_px / float(np.hypot(*between))
        turn = np.deg2rad(lean_deg) - np.arctan2(between[1], between[0])
        c, s = np.cos(turn) * scale, np.sin(turn) * scale
        linear = np.array([[c, -s], [s, c]])
        matrix = np.column_stack([linear, MIDDLE - linear @ middle])
        if scale < 1:
            head = np.asarray(cv2.GaussianBlur(head, (0, 0), 0.4 / scale), np.uint8)
        out = cv2.warpAffine(
            head, matrix, (WIDTH, HEIGHT), flags=cv2.INTER_LINEAR, borderValue=(110, 110, 110)
        )
        return np.asarray(out, np.uint8), self.eyes @ linear.T + matrix[:, 2]


def portraits(folder: Path, kinds: str = KINDS) -> Iterator[Portrait]:
    with (folder / "eyes_truth.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            path = folder / "imm" / Path(row["frame_or_file"]).name
            if row["set"] == "imm" and row["kind"] == "contour8_mean" and path.stem[3] in kinds:
                eyes = np.array([float(row[name]) for name in NAMES]).reshape(2, 2)
                yield Portrait(np.asarray(cv2.imread(str(path)), np.uint8), eyes)


def looked(engine: LitertEngine | MediapipeEngine, pictures: list[Picture]) -> list[Float | None]:
    """The eyes in each of some pictures, of a new choice of the face."""
    engine.reset()
    found = [engine.detect(picture) for picture in pictures]
    return [None if face is None else face.eyes_px for face in found]


def row_of(
    engine: LitertEngine | MediapipeEngine, condition: Condition, heads: list[Portrait]
) -> str:
    first, nine, kept, taken, wrong = 0, 0, 0, 0, 0
    errors: list[float] = []
    shifts: list[float] = []
    for head in heads:
        eye_distance_px, lean_deg = condition.eye_distance_px, condition.lean_deg
        clean, truth = head.placed(eye_distance_px, lean_deg)
        outputs_faulty = condition.paint(clean, eye_distance_px)
        new = looked(engine, [outputs_faulty] * LOOKS)
        leads = [head.placed(eye_distance_px, deg)[0] for deg in np.arange(0.0, lean_deg, 5.0)]
        known = looked(engine, [*(leads or [clean] * LEAD), *[outputs_faulty] * LOOKS])[-LOOKS:]
        first += new[0] is not None
        nine += any(eyes is not None for eyes in new)
        kept += known[-1] is not None
        off = [
            float(np.hypot(*(eyes - truth).T).mean()) / eye_distance_px
            for eyes in (*new, *known)
            if eyes is not None
        ]
        taken += len(off)
        wrong += sum(error > WRONG for error in off)
        last = next((eyes for eyes in reversed(new) if eyes is not None), None)
        unspoilt = looked(engine, [clean] * LEAD)[-1]
        if last is not None:
            errors.append(float(np.hypot(*(last - truth).T).mean()) / eye_distance_px)
            if unspoilt is not None:
                shifts.append(100 * float(np.hypot(*(last - unspoilt).T).mean()) / eye_distance_px)
    shares = [f"{100 * count / len(heads):.0f}" for count in (first, nine, kept)]
    shares.append(f"{100 * wrong / taken:.0f}" if taken else "-")
    middle = [f"{np.mean(errors):.3f} | {np.percentile(errors, 95):.3f}" if errors else "- | -"]
    middle.append(f"{np.median(shifts):.1f} | {np.percentile(shifts, 95):.1f}" if shifts else "-|-")
    return f"| {condition.name} | {' | '.join(shares + middle)} |"


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("faces", type=existing)
    parser.add_argument("--engine", choices=("litert", "mediapipe"), default="litert")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    engine = LitertEngine() if given.engine == "litert" else MediapipeEngine()
    heads = list(portraits(given.faces))
    print(f"{given.engine}, {len(heads)} portraits, found and kept in %\n")
    print("| condition | first | 9 | kept | wrong | NME | p95 | shift | p95 |")
    print(f"|---|{'---:|' * 8}")
    for condition in CONDITIONS:
        print(row_of(engine, condition, heads), flush=True)


if __name__ == "__main__":
    start(main)
