# SPDX-License-Identifier: Apache-2.0
"""How the cost grows with fingers, joints, hands and with the fineness of the plant's steps.

The hands are made for the purpose: equal fingers around a prism with a side for each of them.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from bench.blocks import controller_times, optimizer_times, plant_times
from bench.hands import prism_grasp
from bench.results import Result
from bench.workload import Workload
from tactile_hand_ros.closed_loop.loop import ClosedLoop
from tactile_hand_ros.closed_loop.record import Record
from tactile_hand_ros.scenario.scenario import Scenario, load_scenario

Array = NDArray[np.float64]

FINGERS, JOINTS = (3, 4, 5), (3, 4, 5, 6)
STEPS = (1e-3, 5e-4, 2e-4, 1e-4)  # s
OPTIMIZER, CONTROLLER, PLANT = "(13)", "controller", "plant step"
ONE_HAND, TWO_HANDS = "closed loop tick", "closed loop tick, two hands"
BLOCKS = (OPTIMIZER, CONTROLLER, PLANT, ONE_HAND, TWO_HANDS)
TICKS = 300
ROUNDS = 3
_SMALLEST = (3, 3)
_HOLDING = {
    "plant.object.mass": 0.1,
    "manipulation_controller.law.k_p": 30.0,
    "manipulation_controller.law.k_o": 3.0,
    "manipulation_controller.law.damping": 0.3,
}


@dataclass(frozen=True)
class Size:
    """What is held, and how finely it is simulated.

    Attributes:
        fingers: Number of fingers.
        joints: Number of joints of each finger.
        step: Integration step of the plant [s].
    """

    fingers: int
    joints: int
    step: float = STEPS[0]

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.fingers} fingers of {self.joints} joints, {1e3 * self.step:g} ms"


@dataclass(frozen=True)
class Cost:
    """What a size costs.

    Attributes:
        size: The size.
        rounds: Times of each round [s], by the names in `BLOCKS`.
    """

    size: Size
    rounds: dict[str, list[Array]] = field(default_factory=lambda: {name: [] for name in BLOCKS})

    def median(self, block: str) -> float:
        """Return the median of a block in its quietest round [us]: what disturbs only adds."""
        return 1e6 * min(float(np.median(times)) for times in self.rounds[block])


def sizes() -> list[Size]:
    """Return all hands at the ordinary step, then the smallest at finer ones."""
    hands = [Size(*each) for each in product(FINGERS, JOINTS)]
    return hands + [Size(*_SMALLEST, step) for step in STEPS[1:]]


def measure_sizes(
    chosen: Sequence[Size],
    ticks: int = TICKS,
    rounds: int = ROUNDS,
    progress: Callable[[str], None] = lambda _: None,
) -> list[Cost]:
    """Measure sizes in turns, so that what changes on the machine meets all of them.

    Args:
        chosen: The sizes.
        ticks: Length of the runs.
        rounds: How often each size has its turn.
        progress: Called with the name of each size at each turn.
    """
    costs = [Cost(size) for size in chosen]
    with tempfile.TemporaryDirectory() as folder:
        works = [_workload(Path(folder) / str(i), size, ticks) for i, size in enumerate(chosen)]
        for _ in range(rounds):
            for cost, work in zip(costs, works, strict=True):
                _measure(cost, work)
                progress(str(cost.size))
    return costs


def _measure(cost: Cost, work: Workload) -> None:
    cost.rounds[OPTIMIZER].append(optimizer_times(work)[0])
    cost.rounds[CONTROLLER].append(controller_times(work))
    cost.rounds[PLANT].append(plant_times(work))
    cost.rounds[ONE_HAND].append(loop_times(work, 1))
    cost.rounds[TWO_HANDS].append(loop_times(work, 2))


def loop_times(work: Workload, hands: int) -> Array:
    """Return the time that each tick takes all hands together [s]."""
    loops = [ClosedLoop(work.scenario) for _ in range(hands)]
    hand = loops[0].plant.hand
    ticks = len(work.record)
    records = [Record.empty(ticks, hand.finger_names, hand.joint_names) for _ in loops]
    seconds = np.empty(ticks)
    for row in range(ticks):
        start = time.perf_counter()
        for loop, record in zip(loops, records, strict=True):
            loop.tick(record, row)
        seconds[row] = time.perf_counter() - start
    return seconds


def _workload(folder: Path, size: Size, ticks: int) -> Workload:
    """Write a hand and run it once, so that everything is compiled and there are inputs."""
    scenario = sized_scenario(folder, size)
    return Workload(scenario, ClosedLoop(scenario).run(ticks), 1)


def sized_scenario(folder: Path, size: Size) -> Scenario:
    """Write a hand into a folder and return a scenario in which it moves an object a little.

    Raises:
        HandSizeError: If the fingers do not reach the object.
    """
    folder.mkdir(parents=True, exist_ok=True)
    values = {
        **prism_grasp(folder, [size.joints] * size.fingers),
        **_HOLDING,
        "plant.time_step": size.step,
        "targets": [],
    }
    # R_pod is that of the contacts' own frame, which starts as their places make it.
    start = ClosedLoop(load_scenario("paper", values)).run(1)
    kept = Rotation.from_quat(start.auxiliary_quaternion[0]).as_rotvec().tolist()
    place = (start.auxiliary_position[0] + [0.01, -0.01, 0.01]).tolist()
    return load_scenario("paper", {**values, "targets": [{"position": place, "rotation": kept}]})


def results(costs: Sequence[Cost]) -> list[Result]:
    """Sum up costs."""
    return [
        Result.of(f"{block}: {cost.size}", "us", 1e6 * np.concatenate(cost.rounds[block]))
        for block in BLOCKS
        for cost in costs
    ]
