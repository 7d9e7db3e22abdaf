"""Mutation testing: would a test fail if the code said something else?  ``make mutation``, or ``mutation.py --help``.

cosmic-ray makes the mutants; two kinds that it lacks are added here (a statement left out, minimum for maximum). It
runs one command for every module, in place, and cannot sample: choosing and running is therefore done here, in copies
of the tree, with the tests of the mutated module, those first that ended soonest without any mutation. A mutant that no
quick test kills meets the slow tests of its module and then :data:`EVERYWHERE`.

A mutant that survives lacks a test, or is equivalent: then :data:`EQUIVALENT` says why.

A mutant that makes the tests run for ever is killed by its share of processor time, which another program's work does
not use up; waiting is no kill. ``--resume`` goes on where a file of results ends: new tests meet the old survivors.
"""

from __future__ import annotations

import argparse
import difflib
import json
import math
import os
import queue
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import parso.python.tree as tree
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.operators.operator import Operator
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parents[1]

#: What is mutated, and the tests of each module: those first that are quick and kill many.
MODULES: dict[str, tuple[str, ...]] = {
    "coopqp/model/grasp.py": ("grasp", "paper_equations", "targets", "state", "cell", "chain"),
    "coopqp/model/chain.py": ("chain", "lockstep", "posture", "program", "inverse_kinematics", "qp_controller"),
    "coopqp/task/path.py": ("path", "clocks", "targets", "core", "simulation", "preview", "scenarios"),
    "coopqp/control/limits.py": ("limits", "braking", "lockstep", "program", "qp_controller", "reliability/stopping"),
    "coopqp/control/forms.py": ("program", "lockstep", "core", "posture", "public_names", "qp_controller"),
    "coopqp/control/ranks.py": ("lockstep", "core", "program", "constraint_rows", "qp_controller", "posture"),
    "coopqp/control/linearised.py": ("linearised", "braking", "lockstep", "qp_controller", "program"),
    "coopqp/control/drift.py": ("lockstep", "supervision", "qp_controller", "reliability/disturbances"),
    "coopqp/control/plain.py": (
        "braking",
        "lockstep",
        "qp_controller",
        "copies",
        "constraint_rows",
        "supervision",
        "reliability/stopping",
    ),
    "coopqp/control/rate_cap.py": (
        "braking",
        "lockstep",
        "reins",
        "qp_controller",
        "supervision",
        "constraint_rows",
        "reliability/stopping",
    ),
    "coopqp/control/verdict.py": ("verdict", "lockstep", "behaviour", "qp_controller", "reliability/statuses"),
    "coopqp/control/supervision.py": ("supervision", "lockstep", "stress", "qp_controller", "reliability/disturbances"),
    "coopqp/planning/preview.py": (
        "look_ahead",
        "preview",
        "reins",
        "qp_controller",
        "lockstep",
        "scenarios",
        "reliability/user_paths",
        "reliability/saturation",
    ),
    "coopqp/planning/horizon.py": ("look_ahead", "preview", "lockstep", "scenarios", "reliability/saturation"),
    "coopqp/planning/sharing.py": ("sharing", "preview", "lockstep"),
    "coopqp/planning/growth.py": (
        "look_ahead",
        "preview",
        "lockstep",
        "truth",
        "scenarios",
        "reliability/singularities",
    ),
    "coopqp/planning/chain_ahead.py": ("look_ahead", "preview", "lockstep", "qp_controller", "scenarios"),
    "coopqp/planning/knots.py": ("knots", "timing", "plan", "check_path", "branches"),
}
#: Tests of whole runs, for mutants that the module's own let live.
EVERYWHERE = (
    "behaviour",
    "reliability/broken_controllers",
    "reliability/outside",
    "reliability/state_machine",
    "reliability/fuzz_inputs",
    "reliability/singularities",
    "reliability/commands",
)
#: Stands for whichever module.
ANY = ""
#: Mutants that change nothing: module, line, mutated line (stripped), and why no test can see it.
EQUIVALENT: dict[tuple[str, str, str], str] = {
    (module, before, after): why
    for module, changes in {
        "coopqp/model/chain.py": {
            (
                "out[g.columns] = (W[g.arms, None, :] @ inverse)[:, 0, :]",
                "out[g.columns] = (W[g.arms, None, :] @ inverse)[:, -1, :]",
            ): "this axis has one entry",
            (
                "return self._least_squares(g) if g.joints < 6 else self._redundant(g)",
                "return self._least_squares(g) if g.joints <= 6 else self._redundant(g)",
            ): "six joints have an inverse of their own, above",
            (
                "M = np.zeros((12, 13))",
                "M = np.zeros((12, 14))",
            ): "a column of zeros more: the largest of e and −e is 0 or more anyway",
            ("continue", "break"): "the groups are sorted by their joints",
            ("self.singular = False", "pass"): "nobody asks before the Jacobians are inverted, which sets it",
            (
                "gap = data.oMi[2].rotation.ctypes.data - first.ctypes.data if model.njoints > 2 else 96",
                "gap = data.oMi[2].rotation.ctypes.data - first.ctypes.data if model.njoints > 2 else 95",
            ): "from one joint to the next, where there is one joint",
            (
                "contiguous = bool(np.all(np.diff(flat) == 1)) if len(flat) > 1 else True",
                "contiguous = bool(np.all(np.diff(flat) == 1)) if len(flat) > 1 else False",
            ): "one column is the same as a slice and by its index",
        },
        "coopqp/control/limits.py": {
            (
                "a, d = np.where(finite, self._acceleration, 1.0), np.where(finite, distance, 1.0)",
                "a, d = np.where(finite, self._acceleration, 1.0), np.where(finite, distance, 2.0)",
            ): "what stands where nothing is finite is not used",
            (
                "if lowest > _FAR or highest < -_FAR:",
                "if lowest > _FAR or highest <= -_FAR:",
            ): "a rate of exactly −1e100",
            (
                "if longest <= 0.0:",
                "if longest < 0.0:",
            ): "at rest no joint is late",
            (
                "still = np.abs(along) < _STILL",
                "still = np.abs(along) <= _STILL",
            ): "a speed of exactly 1e-12",
        },
        ANY: {
            ("@dataclass(eq=False)", "@dataclass(eq=True)"): "nobody compares these, and none of them is a key",
        },
        "coopqp/control/plain.py": {
            (
                "if by_qp or self._box.accelerates:",
                "if not by_qp or self._box.accelerates:",
            ): "without acceleration limits nobody reads it",
            ("break", "continue"): "what needs no tighter rows needs none when asked again",
            (
                "if self._preview is not None and preview is not None:",
                "if self._preview is not None or preview is not None:",
            ): "a copy looks ahead where the original does",
        },
        "coopqp/control/verdict.py": {
            (
                "rising = rate > s.rate + RATE_ROUNDING",
                "rising = rate >= s.rate + RATE_ROUNDING",
            ): "a rise of exactly the rounding",
            (
                "if rate == 1.0 and answer.exact and not restricted:",
                "if rate == 2.0 and answer.exact and not restricted:",
            ): "the same record, built anew",
        },
        "coopqp/control/ranks.py": {
            (
                "if not largest(np.abs(v - clipped)) <= 2.0 * LIMIT_TOLERANCE "
                "or not _keeps(further, v, 10.0 * LIMIT_TOLERANCE):",
                "if not largest(np.abs(v - clipped)) <= 2.0 / LIMIT_TOLERANCE "
                "or not _keeps(further, v, 10.0 * LIMIT_TOLERANCE):",
            ): "the interval of rates leaves the box by less: the comparison refuses what is no number",
            (
                "if not (high >= max(low, 0.0) and low <= 1.0):",
                "if not (high >= max(low, 0.0) and low < 1.0):",
            ): "a least rate of exactly 1",
        },
        "coopqp/model/grasp.py": {
            (
                "if d > tolerance_m or a > tolerance_rad:",
                "if d > tolerance_m or a >= tolerance_rad:",
            ): "an angle of exactly the tolerance",
            (
                "if d > tolerance_m or a > tolerance_rad:",
                "if d >= tolerance_m or a > tolerance_rad:",
            ): "a distance of exactly the tolerance",
        },
        "coopqp/planning/preview.py": {
            (
                "if share[j] == 0.0 or 1.0 / share[j] >= rise:",
                "if share[j] == 0.0 or 1.0 / share[j] > rise:",
            ): "two bounds that are exactly the same",
        },
        "coopqp/planning/horizon.py": {
            (
                "if share is None or not since <= ahead.square <= share.until or ahead.square >= 1.0:",
                "if share is None or not since < ahead.square <= share.until or ahead.square >= 1.0:",
            ): "for K ahead as before the share is as before",
            (
                "low, high, rate, short_of, cause = 0.0, 1.0, 1.0, _SHORT_OF, least.cause",
                "low, high, rate, short_of, cause = 0.0, 1.0, 0.0, _SHORT_OF, least.cause",
            ): "the first guess alone: the search ends at the same rate",
        },
        "coopqp/planning/growth.py": {
            (
                "if abs(way[-1].clock - breakpoint_) < _SAME_CLOCK and breakpoint_ < self._duration:",
                "if abs(way[-1].clock - breakpoint_) <= _SAME_CLOCK and breakpoint_ < self._duration:",
            ): "a distance of exactly 1 ns",
            (
                "knot = _whole(self._chain.attempt(last, clock - last.clock)) if clock - last.clock > 1e-9 else last",
                "knot = _whole(self._chain.attempt(last, clock - last.clock)) "
                "if clock - last.clock > -0.999999999 else last",
            ): "within 1 ns of a knot the chain is as there, to rounding",
            ("for _ in range(8):", "for _ in range( 9):"): "it has ended long before",
            (
                "if last.clock + h > breakpoint_ - 1e-9:",
                "if last.clock + h >= breakpoint_ - 1e-9:",
            ): "a knot of exactly 1 ns before a breakpoint",
            (
                "if miss * miss_end > 0.0:",
                "if miss * miss_end >= 0.0:",
            ): "a miss of exactly 0 has ended the search",
        },
        "coopqp/planning/chain_ahead.py": {
            (
                "if not ways.item(ways.argmin()) < near:",
                "if not ways.item(ways.argmin()) <= near:",
            ): "a way of exactly that length is not below it in what follows either",
            (
                "if h > options.shortest and not h * knot.fastest <= 1.5 * options.joint_step:",
                "if h >= options.shortest and not h * knot.fastest <= 1.5 * options.joint_step:",
            ): "an interval of exactly the shortest length",
        },
        "coopqp/planning/knots.py": {
            (
                "_PASSES, _SETTLED = 60, 1e-11",
                "_PASSES, _SETTLED = 61, 1e-11",
            ): "it has settled long before",
            (
                "_LOOKS, _LEAST_IN_A_PIECE = 5, 11",
                "_LOOKS, _LEAST_IN_A_PIECE = 5, 12",
            ): "a knot more in each piece: a choice",
            (
                "uses = [np.abs(a.slope / arm.scale).max(axis=1) "
                "for a, arm in zip(self._coarse, self._arms, strict=True)]",
                "uses = [np.abs(a.slope / arm.scale).max(axis=1) "
                "for a, arm in zip(self._coarse, self._arms, strict=False)]",
            ): "there is one for each arm",
            (
                "if not np.isfinite(ahead).all():",
                "if not np.isfinite(ahead).any():",
            ): "where it is singular the arm ends in either case, and only its last knot is named",
        },
        "coopqp/control/supervision.py": {
            ("if o.let_in > 0.0:", "if o.let_in > -1.0:"): "with 0 no drift is let in, only later",
            (
                "self._noise, self._samples, self._cap, self._arm = np.zeros(n), 0.0, 1.0, -1",
                "self._noise, self._samples, self._cap, self._arm = np.zeros(n), 0.0, 1.0, - 2",
            ): "any number below 0 is no arm",
            (
                "self._widest[:] = 0.0",
                "self._widest[:] = 1.0",
            ): "it is set to 0 when an arm stalls, and not read before",
            ("if radius != 1.0:", "if radius != 2.0:"): "a division by 1",
            (
                "self._past: deque[tuple[Array, Array]] = deque(maxlen=1 + (options.stall_samples or 1))",
                "self._past: deque[tuple[Array, Array]] = deque(maxlen=1 + (options.stall_samples or 2))",
            ): "without stall_samples nobody looks at the past",
            (
                "if far > self._options.joint_jump:",
                "if far >= self._options.joint_jump:",
            ): "a jump of exactly the limit",
            (
                "self._pressed = force >= (_LET_GO * limit if self._pressed else limit)",
                "self._pressed = force > (_LET_GO * limit if self._pressed else limit)",
            ): "a force of exactly the limit",
        },
    }.items()
    for (before, after), why in changes.items()
}

_COSMIC = [
    *(f"ReplaceBinaryOperator_{pair}" for pair in (
        "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul", "FloorDiv_Div", "Mod_Mul",
        "BitAnd_BitOr", "BitOr_BitAnd",
    )),
    *(f"ReplaceComparisonOperator_{pair}" for pair in (
        "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt", "Eq_NotEq", "NotEq_Eq",
        "Is_IsNot", "IsNot_Is",
    )),
    "ReplaceUnaryOperator_Delete_USub", "ReplaceUnaryOperator_Delete_Not", "ReplaceUnaryOperator_Delete_Invert",
    "AddNot", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceTrueWithFalse", "ReplaceFalseWithTrue",
    "ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop", "ExceptionReplacer",
    "NumberReplacer",
]  # fmt: skip
_PAIRS = ("minimum maximum", "min max", "any all", "argmin argmax", "floor ceil", "sin cos", "fmin fmax")
_OTHER = {a: b for pair in _PAIRS for a, b in (pair.split(), pair.split()[::-1])}


class _Kind(Operator):  # type: ignore[misc]
    """A kind of mutation with one mutant a place."""

    @classmethod
    def examples(cls) -> tuple[()]:
        return ()

    def fits(self, node: Any) -> bool:
        raise NotImplementedError

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        if self.fits(node):
            yield node.start_pos, node.end_pos


class OtherFunction(_Kind):
    """The minimum for the maximum, and such."""

    def fits(self, node: Any) -> bool:
        return isinstance(node, tree.Name) and node.value in _OTHER and not node.is_definition()

    def mutate(self, node: Any, index: int) -> Any:
        return tree.Name(_OTHER[node.value], node.start_pos, prefix=node.prefix)


class LeaveOut(_Kind):
    """Without a call, or without an assignment to something that is there already."""

    def fits(self, node: Any) -> bool:
        if node.parent is None or node.parent.type != "simple_stmt" or node is not node.parent.children[0]:
            return False
        if node.type == "expr_stmt":
            target, operator = node.children[:2]
            return operator.type != "annassign" and (target.type != "name" or operator.value != "=")
        return node.type == "atom_expr"

    def mutate(self, node: Any, index: int) -> Any:
        return tree.Keyword("pass", node.start_pos, prefix=node.get_first_leaf().prefix)


OPERATORS: dict[str, Operator] = {name: get_operator(f"core/{name}")() for name in _COSMIC}
OPERATORS |= {"OtherFunction": OtherFunction(), "LeaveOut": LeaveOut()}


@dataclass
class Mutant:
    """One change of one module, and what came of it."""

    module: str
    operator: str
    occurrence: int
    line: int
    before: str = ""
    after: str = ""
    diff: str = ""
    outcome: str = ""
    killer: str = ""
    seconds: float = 0.0

    def write(self, source: str) -> str:
        """The text of the module with this change, which is noted."""
        mutated: str | None = mutate_code(source, OPERATORS[self.operator], self.occurrence)
        assert mutated is not None, self
        assert mutated != source, self
        lines = list(difflib.unified_diff(source.splitlines(), mutated.splitlines(), lineterm="", n=2))[2:]
        self.diff = "\n".join(lines)
        self.before, self.after = (
            " ".join(line[1:].strip() for line in lines if line.startswith(sign)) for sign in "-+"
        )
        return mutated

    @property
    def why_equivalent(self) -> str | None:
        found = ((module, self.before, self.after) for module in (self.module, ANY))
        return next((EQUIVALENT[key] for key in found if key in EQUIVALENT), None)


def annotations(module: Any) -> list[tuple[Any, Any]]:
    """Where types are written, which nothing evaluates."""
    found = []
    for node in ast_nodes(module):
        if node.type == "annassign":
            found.append(node.children[1])
        elif node.type in ("param", "funcdef") and node.annotation is not None:
            found.append(node.annotation)
    return [(node.start_pos, node.end_pos) for node in found]


#: Where a star multiplies nothing.
_STARRED = ("parameters", "typedargslist", "param", "argument", "arglist", "star_expr")


def sites(source: str) -> dict[Any, list[tuple[str, int]]]:
    """The mutants of a module by the place that they change: operator and its occurrence."""
    module = get_ast(source)
    types, found = annotations(module), defaultdict(list)
    for name, operator in OPERATORS.items():
        occurrence = 0
        for node in ast_nodes(module):
            for start, end in operator.mutation_positions(node):
                huge = node.type == "number" and abs(eval(node.value)) >= 2.0**53  # one more is the same
                starred = node.type == "operator" and node.parent.type in _STARRED
                if not huge and not starred and not any(a <= start and end <= b for a, b in types):
                    found[start].append((name, occurrence))
                occurrence += 1
    return dict(found)


def chosen(modules: list[str], number: int, seed: int) -> list[Mutant]:
    """Mutants at ``number`` places of all modules, one a place; any place of a module as likely as any other.

    Each module has its share, and those of ``modules`` are returned. What is chosen stays chosen when other lines
    change, and a smaller number chooses the first ones of a larger.
    """
    sources = {module: (ROOT / module).read_text(encoding="utf-8") for module in MODULES}
    places = {module: sites(source) for module, source in sources.items()}
    every = sum(map(len, places.values()))
    print(f"{every} places in {len(MODULES)} modules", flush=True)
    mutants = []
    for module in modules:
        found, lines, drawn = places[module], sources[module].splitlines(), []
        for start, ways in found.items():
            rng = random.Random(f"{seed} {module} {start[1]} {lines[start[0] - 1]}")
            drawn.append((rng.random(), start[0], rng.choice(ways)))
        for _, line, (operator, occurrence) in sorted(drawn)[: math.ceil(number * len(drawn) / every)]:
            mutants.append(Mutant(module, operator, occurrence, line))
    return mutants


def test_file(name: str) -> str:
    """The file that the tables call by a short name."""
    return "tests/" + re.sub(r"(\w+)$", r"test_\1.py", name)


#: Runs pytest as often as it is told to, each time in a child that finds all but this package imported.
_TESTER = """
import json, os, resource, sys
import hypothesis.strategies, numpy, pinocchio, pytest

took = {}


class Soonest:
    def pytest_collection_modifyitems(self, items):
        items.sort(key=lambda item: took.get(item.nodeid, 1e9))

    def pytest_runtest_logreport(self, report):
        took[report.nodeid] = took.get(report.nodeid, 0.0) + report.duration

    def pytest_sessionfinish(self, session):
        if job["measure"]:
            with open(job["times"], "w") as file:
                json.dump(took, file)


for line in sys.stdin:
    job = json.loads(line)
    if not took and os.path.exists(job["times"]):
        with open(job["times"]) as file:
            took = json.load(file)
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, (job["limit"], job["limit"] + 5))
        said = os.open(job["said"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(said, 1), os.dup2(said, 2)
        status = 3
        try:
            status = int(pytest.main(job["arguments"], plugins=[Soonest()]))
        finally:
            sys.stdout.flush()
            os._exit(status)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Copy:
    """A copy of the tree, in which one mutant after the other is tested."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        shutil.copytree(
            ROOT, folder, ignore=shutil.ignore_patterns(".*", "out", "build", "dist", "__pycache__"), symlinks=True
        )
        locate = (
            "import importlib.util as u; s = u.find_spec('coopqp.control.core._native'); print(s.origin if s else '')"
        )
        native = subprocess.run([sys.executable, "-c", locate], cwd=ROOT, capture_output=True, text=True, check=True)
        if file := native.stdout.strip():
            shutil.copy(file, folder / "coopqp/control/core")
        path = [str(folder / "tests" / "elsewhere"), str(folder)]
        self._environment = {
            **os.environ, "PYTHONPATH": os.pathsep.join(path), "HYPOTHESIS_PROFILE": "mutation",
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip
        where = subprocess.run(
            [sys.executable, "-c", "import coopqp; print(coopqp.__file__)"],
            env=self._environment, cwd=folder, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert Path(where.stdout.strip()).is_relative_to(folder), where.stdout
        self._tester = subprocess.Popen(
            [sys.executable, "-c", _TESTER],
            env=self._environment, cwd=folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    def killer(self, files: tuple[str, ...], *options: str, limit: int, measure: bool = False) -> str:
        """The test that failed, or "" if none did; each process of the tests has ``limit`` seconds of a processor.

        What each test takes is written down with ``measure``, for all copies.
        """
        tests = [test_file(name) for name in files]
        said = self.folder / "said.txt"
        job = {
            "arguments": ["-x", "-p", "no:cacheprovider", "--timeout", "0", *options, *tests], "limit": limit,
            "times": str(self.folder.parent / "times.json"), "measure": measure,
        }  # fmt: skip
        assert self._tester.stdin is not None
        assert self._tester.stdout is not None
        print(json.dumps({**job, "said": str(said)}), file=self._tester.stdin, flush=True)
        status = int(self._tester.stdout.readline())
        if status in (0, 5):  # 5: no test of that kind
            return ""
        if status == -signal.SIGXCPU:
            return "runs for ever"
        found = re.search(r"^(?:FAILED|ERROR) (\S+)", said.read_text(encoding="utf-8"), re.MULTILINE)
        return found.group(1) if found else f"status {status}"

    def stages(self, files: tuple[str, ...], *, quick: bool) -> Iterator[str]:
        yield self.killer(files, "-m", "not slow", limit=150)
        if not quick:
            yield self.killer(files, "-m", "slow", limit=1200)
            yield self.killer(EVERYWHERE, limit=2400)

    def test(self, mutant: Mutant, files: tuple[str, ...], *, quick: bool) -> Mutant:
        """Write the mutant, run the tests of these files, put the module back."""
        file, started = self.folder / mutant.module, time.monotonic()
        source = file.read_text(encoding="utf-8")
        mutated = mutant.write(source)
        try:
            file.write_text(mutated, encoding="utf-8")
            self._forget(file)
            mutant.killer = next(filter(None, self.stages(files, quick=quick)), "")
        finally:
            file.write_text(source, encoding="utf-8")
            self._forget(file)
        mutant.outcome = "killed" if mutant.killer else "equivalent" if mutant.why_equivalent else "survived"
        mutant.seconds = time.monotonic() - started
        return mutant

    @staticmethod
    def _forget(file: Path) -> None:
        """Compiled, one second may be as good as another to Python, and one length as good as another."""
        for compiled in (file.parent / "__pycache__").glob(f"{file.stem}.*.pyc"):
            compiled.unlink()


def report(mutants: list[Mutant]) -> float:
    """Print what came out; share of those killed that can be [1]."""
    for m in mutants:
        if m.outcome == "survived":
            print(f"\nsurvived: {m.module}:{m.line} {m.operator}\n{m.diff}")
    print(f"\n{'':34}{'killed':>8}{'survived':>10}{'equivalent':>12}")
    rows = [(module, [m for m in mutants if m.module == module]) for module in MODULES]
    for name, those in [*((module, those) for module, those in rows if those), ("all", mutants)]:
        n = Counter(m.outcome for m in those)
        print(f"{name:34}{n['killed']:>8}{n['survived']:>10}{n['equivalent']:>12}")
    n = Counter(m.outcome for m in mutants)
    return n["killed"] / max(1, n["killed"] + n["survived"])


def main() -> int:
    parser = argparse.ArgumentParser(description="Mutation testing of the modules that everything rests on.")
    parser.add_argument("--number", type=int, default=400, help="mutants in all modules (default 400)")
    parser.add_argument("--seed", type=int, default=1, help="choice of the mutants (default 1)")
    parser.add_argument("--only", nargs="+", choices=MODULES, metavar="MODULE", help="of these modules (default all)")
    parser.add_argument("--least", type=float, default=0.9, help="share to be killed (default 0.9)")
    parser.add_argument("--processes", type=int, default=2, help="mutants at a time (default 2)")
    parser.add_argument("--quick", action="store_true", help="quick tests only")
    parser.add_argument("--files", type=int, metavar="N", help="of the tests of each module the first N files only")
    parser.add_argument("--json", type=Path, help="write each mutant and what came of it to this file")
    parser.add_argument(
        "--resume",
        action="store_true",
        help="leave out what the file of --json says was killed or survived as equivalent",
    )
    parser.add_argument("--list", action="store_true", help="print the mutants, and test none")
    args = parser.parse_args()
    modules = args.only or list(MODULES)
    tests = {module: MODULES[module][: args.files] for module in modules}
    named = [*MODULES, *(test_file(name) for names in (*MODULES.values(), EVERYWHERE) for name in names)]
    if lost := [name for name in named if not (ROOT / name).exists()]:
        parser.error(f"the tables of {Path(__file__).name} name what is not there: {', '.join(sorted(set(lost)))}")
    mutants, tested, others = chosen(modules, args.number, args.seed), [], []
    if args.list:
        for m in mutants:
            print(f"{m.module}:{m.line} {m.operator} {m.occurrence}")
        return 0
    if args.resume:
        if not args.json:
            parser.error("--resume goes on with the file of --json: name it")
        kept = [Mutant(**m) for m in json.loads(args.json.read_text(encoding="utf-8"))] if args.json.exists() else []
        for m in mutants:
            m.write((ROOT / m.module).read_text(encoding="utf-8"))
        others = [m for m in kept if m.module not in modules]
        known = {(m.module, m.operator, m.diff): m for m in kept if m.outcome == "killed" or m.why_equivalent}
        tested = [known[m.module, m.operator, m.diff] for m in mutants if (m.module, m.operator, m.diff) in known]
        mutants = [m for m in mutants if (m.module, m.operator, m.diff) not in known]
        for m in tested:
            m.outcome = "equivalent" if m.why_equivalent else m.outcome
        print(f"{len(tested)} were killed before or are equivalent, {len(mutants)} are left", flush=True)
    all_of_them = len(tested) + len(mutants)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(args.processes) as pool:
        copies: queue.SimpleQueue[Copy] = queue.SimpleQueue()
        for i in range(args.processes):
            copies.put(Copy(Path(folder) / str(i)))

        def run(mutant: Mutant) -> Mutant:
            copy = copies.get()
            try:
                return copy.test(mutant, tests[mutant.module], quick=args.quick)
            finally:
                copies.put(copy)

        sound = copies.get()
        files = tuple(dict.fromkeys(f for m in mutants for f in tests[m.module]))
        kinds = ["-m", "not slow"] if args.quick else []
        if mutants and (killer := sound.killer(files, "-n", str(args.processes), *kinds, limit=3600, measure=True)):
            print(f"without any mutation {killer} fails")
            return 2
        copies.put(sound)
        for done in as_completed([pool.submit(run, mutant) for mutant in mutants]):
            m = done.result()
            tested.append(m)
            print(
                f"{len(tested):4}/{all_of_them} {m.seconds:5.0f} s {m.outcome:10} {m.module}:{m.line} {m.operator} "
                f"{m.killer}",
                flush=True,
            )
            if args.json:
                args.json.write_text(json.dumps([asdict(m) for m in others + tested], indent=1), encoding="utf-8")
    share = report(tested)
    print(f"\n{share:.1%} killed, {args.least:.0%} asked")
    return int(share < args.least)


if __name__ == "__main__":
    sys.exit(main())
