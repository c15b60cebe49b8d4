# SPDX-License-Identifier: Apache-2.0
"""Redraw the diagrams of docs/architecture.md from the code: ``python docs/draw_architecture.py``.

The layers come from the imports. The three paths come from running code: the modules that a tick,
a slip and a recording pass through, in the order in which they call each other. With ``--check``
nothing is written, and the exit code is 1 when a diagram is out of date.
"""

from __future__ import annotations

import argparse
import ast
import os
import sys
import tempfile
import types
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

PACKAGE = "tactile_hand_ros"
DOCS = Path(__file__).resolve().parent
PAGE = DOCS / "architecture.md"
Edges = dict[tuple[str, str], None]
Match = Callable[[types.FrameType], bool]

STILL = {"targets": [], "user_forces": []}
"""Changes that let a scenario end early."""


def layers() -> Edges:
    """Return which folder imports which, without what follows from other arrows."""
    uses: dict[str, set[str]] = {}
    for path in sorted((DOCS.parent / PACKAGE).rglob("*.py")):
        own = _folder(path.relative_to(DOCS.parent).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith(f"{PACKAGE}."):
                uses.setdefault(own, set()).add(_folder(tuple(str(node.module).split("."))))
    plain = {"", "cholesky", "config", "errors", "extras", "files", "jit", "names", "rotations"}
    graph = {name: {u for u in used if u not in {*plain, name}} for name, used in uses.items()}
    graph = {name: used for name, used in graph.items() if name not in plain}
    return {
        (name, used): None
        for name in sorted(graph)
        for used in sorted(graph[name])
        if not any(used in _below(other, graph) for other in graph[name] - {used})
    }


def _folder(parts: tuple[str, ...]) -> str:
    return parts[1] if len(parts) > 1 and parts[1] != "__init__" else ""


def _below(name: str, graph: dict[str, set[str]]) -> set[str]:
    direct = graph.get(name, set())
    return direct.union(*(_below(other, graph) for other in direct))


class Tracer:
    """Notes which module calls which, below the calls that a test picks."""

    def __init__(self, starts: Match) -> None:
        """Follow the calls for which `starts` is true, and all that they call."""
        self.edges: Edges = {}
        self._starts = starts
        self._stack: list[str] = []  # modules of the calls that are followed

    def __call__(self, frame: types.FrameType, event: str, _: object) -> None:
        """Take an event of `sys.setprofile`."""
        if event == "return" and self._stack:
            self._stack.pop()
        elif event == "call" and (self._stack or self._starts(frame)):
            self._stack.append(self._enter(frame))

    def _enter(self, frame: types.FrameType) -> str:
        name = str(frame.f_globals.get("__name__", ""))
        above = self._stack[-1] if self._stack else ""
        if not name.startswith(f"{PACKAGE}.") or frame.f_code.co_name == "<module>":
            return above
        own = name.removeprefix(f"{PACKAGE}.")
        if above and above != own:
            self.edges.setdefault((above, own))
        return own


def trace_loop(scenario_name: str, until_ns: int, listener: str, after_ns: int) -> Edges:
    """Run the composed nodes and return the path of ticks through one of them.

    Args:
        scenario_name: What is run, in lockstep.
        until_ns: Tick at which the run ends [ns].
        listener: Class of the node whose path is drawn.
        after_ns: Tick from which its path is drawn [ns].
    """
    import rclpy

    from tactile_hand_ros.closed_loop.scenario import NODES, load_scenario
    from tactile_hand_ros.nodes.composed import MEMBERS
    from tactile_hand_ros.ros.domains import isolated_domain
    from tactile_hand_ros.ros.executor import spin
    from tactile_hand_ros.ros.parameters import to_params_yaml

    seen = [0]

    def starts(frame: types.FrameType) -> bool:
        owner = frame.f_locals.get("self")
        call = f"{type(owner).__name__}.{frame.f_code.co_name}"
        if owner is not None and call == "PlantRun.advance":
            seen[0] = owner.stamp
        if call not in ("TickInputs._take", "TickInputs._answer_waiting"):
            return False
        return type(owner._listener).__name__ == listener and seen[0] >= after_ns

    scenario = load_scenario(scenario_name, {"duration": 1e-9 * until_ns, **STILL})
    with isolated_domain(), tempfile.TemporaryDirectory() as folder:
        arguments = ["draw", "--ros-args"]
        for name in NODES:
            path = Path(folder) / f"{name}.yaml"
            path.write_text(to_params_yaml(scenario.node_config(name), name), encoding="utf-8")
            arguments += ["--params-file", str(path)]
        rclpy.init(args=arguments)
        nodes = [make() for make in MEMBERS]
        nodes[-1].create_timer(0.05, lambda: seen[0] >= until_ns - 10**7 and rclpy.try_shutdown())
        tracer = Tracer(starts)
        with _profiled(tracer):
            spin(nodes)
        for node in nodes:
            node.destroy_node()
    return tracer.edges


@contextmanager
def _profiled(tracer: Tracer) -> Iterator[None]:
    sys.setprofile(tracer)
    try:
        yield
    finally:
        sys.setprofile(None)


def trace_report() -> Edges:
    """Record a short run and return the path from its bag to report.html."""
    from tactile_hand_ros.orchestrator import main
    from tactile_hand_ros.report.page import write_report
    from tactile_hand_ros.run.run import Run

    with tempfile.TemporaryDirectory() as folder:
        line = ["--scenario", "paper", "--out", folder, "--composed", "--no-report", "--quiet"]
        main(["orchestrator", *line, "--duration", "0.2", "--set", "targets=[]"])
        run = Run(Path(folder) / "latest")
        tracer = Tracer(lambda frame: frame.f_code.co_name == "write_report")
        with _profiled(tracer):
            write_report(run)
    return tracer.edges


def mermaid(edges: Iterable[tuple[str, str]]) -> str:
    """Return a diagram in the language that code hosts draw in Markdown."""
    folders: dict[str, list[str]] = {}
    for name in dict.fromkeys(name for edge in edges for name in edge):
        folders.setdefault(name.rpartition(".")[0], []).append(name)
    lines = ["```mermaid", "flowchart LR"]
    for folder, names in folders.items():
        inner = [f'    {_key(name)}["{name.rpartition(".")[2]}"]' for name in names]
        if folder:
            inner = [f'  subgraph {_key(folder)}_ ["{folder.replace(".", "/")}"]', *inner, "  end"]
        lines += inner
    lines += [f"  {_key(above)} --> {_key(below)}" for above, below in edges]
    return "\n".join([*lines, "```"])


def _key(name: str) -> str:
    return name.replace(".", "_")


def redrawn(text: str, name: str, edges: Edges) -> str:
    """Return the page with one diagram replaced, between ``<!-- name -->`` and ``<!-- end -->``."""
    begin, end = f"<!-- drawn: {name} -->\n", "\n<!-- end -->"
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    modules = len({name for edge in edges for name in edge})
    return f"{head}{begin}{mermaid(edges)}\n\n{modules} boxes.{end}{tail}"


def main() -> int:
    """Draw, or check what is drawn, and return the exit code."""
    parser = argparse.ArgumentParser(description="Redraw the diagrams of docs/architecture.md.")
    parser.add_argument("--check", action="store_true", help="write nothing, fail if out of date")
    check = parser.parse_args().check
    os.environ["TACTILE_HAND_INTERPRETED"] = "1"  # compiled functions cannot be followed
    text = before = PAGE.read_text("utf-8")
    controller, regulator = "ManipulationControllerNode", "SlipRegulatorNode"
    text = redrawn(text, "layers", layers())
    text = redrawn(text, "tick", trace_loop("paper", 10**8, controller, 4 * 10**7))
    text = redrawn(text, "slip", trace_loop("pull", 2 * 10**8, regulator, 10**8))
    text = redrawn(text, "report", trace_report())
    if check:
        return int(text != before)
    PAGE.write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
