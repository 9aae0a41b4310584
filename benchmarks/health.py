"""How honest the offset of disparities is: streets and recordings with and without shifted right images, knocked rigs.

``python -m benchmarks.health [--streets N] [--data FOLDER]... [--docs docs]``. Right images are shifted by cubic
interpolation. Of a recording the offset as it is stands for the truth, since nobody knows that.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tspslam import Rig, StereoPair
from tspslam.datasets import open_sequence, synthetic
from tspslam.run.offset_doubts import offset_doubts
from tspslam.vision.slam.back_end.disparity_bias import LARGE_OFFSET, DisparityBias
from tspslam.vision.slam.back_end.offset_steps import OffsetStep as Step
from tspslam.vision.slam.least_squares.offsets import Estimate
from tspslam.vision.slam.odometry import StereoOdometry

RIG = Rig(fx=353.5, fy=353.5, cx=301.0, cy=91.5, baseline=0.54, width=613, height=185)
NOISE = synthetic.Faults(noise=0.01, blur=0.5)
SHIFTS = (-2.0, -1.0, -0.5, 0.5, 1.0, 2.0)  # px


@dataclass
class Found:
    """What a run found, what it warned of, and what would have been right, px."""

    bias: DisparityBias
    codes: list[str]
    truth: float

    @property
    def error(self) -> float:
        return self.bias.value - self.truth


def street(seed: int, length: float) -> list[StereoPair]:
    return list(synthetic.SyntheticSequence(synthetic.street(length, seed=seed), RIG, NOISE, seed=seed))


def shifted(pair: StereoPair, shift: float) -> StereoPair:
    """The pair whose disparities are all larger by a shift, px: what the right image shows moves to the left."""
    move = np.array([[1, 0, -shift], [0, 1, 0]], np.float32)
    size = pair.right.shape[1], pair.right.shape[0]
    right = cv2.warpAffine(pair.right, move, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return replace(pair, right=right)


def drive(pairs: Sequence[StereoPair], truth: float) -> Found:
    odometry = StereoOdometry(pairs[0].rig)
    for pair in pairs:
        odometry.process(pair)
    odometry.finish()
    odometry.close()
    bias = odometry.mapper.bias
    said = offset_doubts(odometry.rig, bias, is_fixed=False)
    return Found(bias, [each["code"] for each in said], truth)


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def scatter_of_thirds(thirds: Sequence[Estimate | None]) -> list[float]:
    """Squared errors of the thirds from their weighed mean, in variances, for two degrees of freedom."""
    known = [third for third in thirds if third is not None]
    if len(known) < 3:
        return []
    value, weight = np.array([t.value for t in known]), np.array([t.std for t in known]) ** -2.0
    mean = (value * weight).sum() / weight.sum()
    return [float((weight * (value - mean) ** 2).sum() / 2)]


def shifts(name: str, pairs: Sequence[StereoPair], truth: float) -> Iterator[Found]:
    for shift in SHIFTS:
        found = drive([shifted(pair, shift) for pair in pairs], truth + shift)
        print(f"{name} {shift:+g}: {found.bias.value:+.3f} ± {found.bias.std:.3f} px {found.codes}", flush=True)
        yield found


@dataclass
class Knocked:
    """What a run found whose pairs are shifted by `shift`, px, from pair `time` on."""

    found: Found
    shift: float
    time: int

    @property
    def is_said(self) -> bool:
        return "offset_unexplained" in self.found.codes

    @property
    def step(self) -> Step | None:
        """The step, where it is found and its time is right: the keyframes are on either side of it."""
        health = self.found.bias.health
        step = None if health is None else health.step
        return step if step and step.exceeds(LARGE_OFFSET) and step.before < self.time <= step.after else None


def knocked(name: str, pairs: Sequence[StereoPair]) -> Iterator[Knocked]:
    half = len(pairs) // 2
    for shift in (-1.0, 1.0):
        found = drive([*pairs[:half], *(shifted(pair, shift) for pair in pairs[half:])], np.nan)
        knock = Knocked(found, shift, half)
        print(f"{name} knocked by {shift:+g} at {half}: {knock.step} {found.codes}", flush=True)
        yield knock


def row(name: str, plain: list[Found], moved: list[Found], knocks: list[Knocked], *, is_true: bool) -> list[str]:
    errors = [one.error / one.bias.std for one in plain]
    thirds = [x for one in plain if one.bias.health for x in scatter_of_thirds(one.bias.health.thirds)]
    alarms = sum(bool(one.codes) for one in plain)
    within = sum(abs(one.error) <= min(0.2, 3 * one.bias.std) for one in moved)
    close = sum(abs(one.error) <= 0.2 for one in moved)
    large = [one for one in moved if abs(one.truth) > 0.7]
    told = sum(one.codes == ["disparity_offset"] for one in large)
    said = sum(one.is_said for one in knocks)
    steps = [(abs(one.step.size.value - one.shift), one.step.size.std) for one in knocks if one.step]
    sized = [error <= 0.2 for error, _ in steps], [error <= 3 * std for error, std in steps]
    return [
        name, f"{rms(errors):.2f}" if is_true else "-", f"{np.sqrt(np.mean(thirds)):.2f}" if thirds else "-",
        f"{alarms} of {len(plain)}", f"{max(abs(one.error) for one in moved):.3f}", f"{close} of {len(moved)}",
        f"{within} of {len(moved)}", f"{told} of {len(large)}",
        *(f"{count} of {len(knocks)}" for count in (said, len(steps), *map(sum, sized))),
    ]  # fmt: skip


HEAD = [
    "sequences", "normalised error", "of thirds", "false alarms", "worst error, px", "within 0.2 px",
    "and 3 deviations", "shifts over 0.7 px warned of", "knocks said",
    "with the right time", "steps within 0.2 px", "within 3 deviations",
]  # fmt: skip


def streets(count: int, moved: int) -> list[str]:
    plain, found, knocks = [], [], []
    for seed in range(count):
        pairs = street(seed, 20.0)
        plain.append(drive(pairs, 0.0))
        print(f"street {seed}: {plain[-1].bias.value:+.3f} ± {plain[-1].bias.std:.3f} px", flush=True)
        found += shifts(f"street {seed}", pairs, 0.0) if seed < moved else []
    for seed in range(max(1, moved // 4)):
        knocks += knocked(f"street {seed}", street(seed, 40.0))
    name = f"{count} streets of 20 m, {moved} of them shifted, {len(knocks) // 2} of 40 m knocked"
    return row(name, plain, found, knocks, is_true=True)


def recording(folder: str) -> list[str]:
    source = open_sequence(folder)
    pairs = [source[index] for index in range(len(source))]
    plain = drive(pairs, np.nan)
    print(f"{source.name}: {plain.bias.value:+.3f} ± {plain.bias.std:.3f} px {plain.codes}", flush=True)
    found = list(shifts(source.name, pairs, plain.bias.value))
    return row(source.name, [plain], found, list(knocked(source.name, pairs)), is_true=False)


def table(rows: list[list[str]]) -> str:
    lines = [".. list-table::", "   :header-rows: 1", ""]
    for cells in [HEAD, *rows]:
        lines += [f"   {'*' if k == 0 else ' '} - {cell}" for k, cell in enumerate(cells)]
    return "\n".join(lines) + "\n"


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--streets", type=int, default=30, help="how many; two thirds of them are shifted too")
    parser.add_argument("--data", action="append", default=[], help="a recording")
    parser.add_argument("--docs", type=Path, help="write the table there")
    given = parser.parse_args(arguments)
    rows = [streets(given.streets, -(-2 * given.streets // 3))] if given.streets else []
    rows += map(recording, given.data)
    print(table(rows))
    if given.docs:
        (given.docs / "health_numbers.inc").write_text(table(rows), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
