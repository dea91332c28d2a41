"""RunConfig: the options of a run, their defaults, their help texts and what makes them valid."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, cast, get_args, get_origin, get_type_hints

from kr210_sim.criteria import CLEARANCE_CAP, CLEARANCE_FREE
from kr210_sim.exceptions import BadInput
from kr210_sim.film.format import FPS, SIZE, Format, make_format
from kr210_sim.grading.source import FRAMES, SCOPES, SolverLimits, SolverSource
from kr210_sim.kinds import of_kind
from kr210_sim.randomize import Randomization, read_randomization
from kr210_sim.source import RobotSource
from kr210_sim.viewers.address import HOST, PORT, VIEWERS
from kr210_sim.viewers.pace import check_speed

MAX_CYCLES = 1_000_000
MIN_MASS = 1e-3
"""Lightest target [kg]; MuJoCo needs some inertia."""

MOST_SURE = 1 - 1e-6
"""Highest confidence, and highest rate to prove; 14 million cycles prove that one."""

MAX_JOBS = 1024
MAX_RETRIES = 100
MAX_SEED = 2**64 - 1

SOLVERS = ("analytic", "numeric")
BACKENDS = ("processes", "dask")
RECORDS = ("all", "failed", "none")
EPISODE_CYCLES = 10
"""Cycles in one scene; targets that earlier cycles placed stay in the bin."""

FREE = frozenset(
    {"cycles", "jobs", "backend", "resume", "out", "json", "junit", "report"}
    | {"video", "camera", "size", "fps"}
    | {"min_success", "confidence", "stop_early", "indifference"}
    | {"max_ik_offset", "max_cycle_time", "viewer", "viewer_speed", "host", "port"}
)
"""Options that may change when a run is resumed: none of them changes a cycle that is finished."""


def _option(default: Any, help_text: str, metavar: str | None = None) -> Any:
    return field(default=default, metadata={"help": help_text, "metavar": metavar})


@dataclass(frozen=True, kw_only=True)
class RunConfig:
    """Options of `kr210-sim run`; each field is the command-line option of the same name.

    Raises:
        BadInput: on construction, if a value is impossible, naming the option and the remedy.
    """

    cycles: int = _option(10, "number of pick-and-place cycles", "N")
    episode_cycles: int = _option(
        EPISODE_CYCLES, "cycles that share a scene, what was placed staying in the bin", "N"
    )
    jobs: int = _option(1, "worker processes; they share the episodes out", "N")
    backend: str = _option(
        "processes",
        "where the workers of --jobs are: processes, or dask (a cluster, through joblib)",
        "NAME",
    )
    seed: int = _option(0, "seed of the run; every cycle derives its own from it", "S")
    scene: str = _option("shelf_and_bin", "bundled scene or path of an MJCF world", "NAME|PATH")
    robot: Path | None = _option(None, "a .xacro or .urdf; default: the bundled KR210", "PATH")
    package: tuple[str, ...] = _option(
        (), "folder of a package that the robot names; repeatable", "NAME=DIR"
    )
    xacro_arg: tuple[str, ...] = _option((), "value of a <xacro:arg>; repeatable", "NAME=VALUE")
    gripper: bool = _option(False, "mount the bundled gripper in the place of the robot's own")
    base: str | None = _option(None, "link that stands at robot_base; default: the root", "LINK")
    tip: str | None = _option(None, "link on which the bundled gripper is mounted", "LINK")
    joints: str | None = _option(None, "the six arm joints, separated by commas", "A,B,C,D,E,F")
    fingers: str | None = _option(None, "the two finger joints or links", "A,B")
    cell: str = _option(
        "random",
        "cell of the target: a number, 'random' (drawn for every cycle) or 'all' (a target in "
        "every cell, taken in turn)",
        "N|random|all",
    )
    mass: float = _option(1.0, "mass of the target [kg]", "KG")
    speed: float = _option(1.0, "0 < F <= 1: velocity x F, acceleration x F^2, jerk x F^3", "F")
    clearance: float = _option(
        CLEARANCE_FREE, "kept to everything outside the cells [m]; 0 to 0.1", "M"
    )
    randomize: str | None = _option(
        None, "what is random: course, nominal, hard, or a .toml or .json file", "PRESET|FILE"
    )
    retries: int = _option(
        0, "further tries at a grasp that the gripper feels to have failed in the cell", "N"
    )
    ik: str = _option(
        "analytic",
        "inverse kinematics to use: analytic, numeric, or your own as FILE.py:FUNC or MODULE:FUNC",
        "NAME",
    )
    ik_scope: str | None = _option(
        None,
        "where your own is asked: course (the two planned legs, the default) or all (the straight "
        "lines as well)",
        "WHICH",
    )
    frame: str = _option(
        "gripper_link", "frame whose poses your own is sent: gripper_link or link_6", "LINK"
    )
    pose_timeout: float = _option(30.0, "longest time your own may take for one pose [s]", "S")
    time_limit: float = _option(900.0, "longest time it may take for all of an episode [s]", "S")
    min_success: float = _option(0.8, "success rate below which the exit status is 1", "F")
    confidence: float | None = _option(
        None, "with which --min-success must be proved, by an exact test", "C"
    )
    stop_early: bool = _option(
        False, "end as soon as that is decided, by Wald's sequential test; --cycles at most"
    )
    indifference: float | None = _option(
        None,
        "of --stop-early: width above --min-success in which either verdict is right; default: "
        "0.8 of what is left to 1",
        "W",
    )
    max_ik_offset: float | None = _option(
        None, "largest end-effector offset of any solved pose [m] above which it is 1", "M"
    )
    max_cycle_time: float | None = _option(
        None, "time of the slowest successful cycle [s] above which it is 1, too", "S"
    )
    out: Path | None = _option(
        None, "folder of the results; default: runs/<time>-seed<S>; never overwritten", "DIR"
    )
    resume: bool = _option(
        False, "go on with the run in --out: finished episodes stay, with --cycles it grows"
    )
    only_cycle: int | None = _option(
        None, "play this cycle alone, after those before it in its episode: a failure again", "N"
    )
    record: str = _option(
        "all", "cycles whose record and world are kept: all, failed or none", "WHICH"
    )
    junit: Path | None = _option(None, "also write the cycles as JUnit test cases", "PATH")
    json: bool = _option(False, "print the summary as JSON on stdout, all else on stderr")
    video: str | None = _option(
        None, "film of the run, off screen; default path: <out>/film.mp4", "PATH"
    )
    camera: tuple[str, ...] = _option(
        (), "camera of the film, by name, or 'gripper', which follows it; repeatable", "NAME"
    )
    size: str = _option(SIZE, "size of the film [pixels]", "WxH")
    fps: float = _option(FPS, "frames a second of the film", "N")
    report: bool = _option(False, "also write <out>/report.html, one page with everything")

    viewer: str | None = _option(
        None, "watch the run: web, a page in the browser, or native, MuJoCo's window", "NAME"
    )
    viewer_speed: float = _option(1.0, "simulated over real time while it is watched", "F")
    host: str = _option(HOST, "address that --viewer web listens on", "HOST")
    port: int = _option(PORT, "port that --viewer web listens on", "N")

    def __post_init__(self) -> None:
        """Check every value; lists become tuples, paths may be text, and a cell a number."""
        for name, (default, about) in self.metadata().items():
            value = getattr(self, name)
            if value is not None or default is not None:
                value = of_kind("--" + name.replace("_", "-"), value, about["kind"])
                object.__setattr__(self, name, value)
        if not 1 <= self.cycles <= MAX_CYCLES:
            raise BadInput(
                f"--cycles: {_short(self.cycles)} is out of range; give 1 to {MAX_CYCLES}"
            )
        if not 0 <= self.seed <= MAX_SEED:
            raise BadInput(f"--seed: {_short(self.seed)} is out of range; give 0 to {MAX_SEED}")
        self._check_campaign()
        if self.cell not in ("random", "all") and not _is_cell_number(self.cell):
            raise BadInput(f"--cell: '{self.cell}' is no cell; give a number from 1, random or all")
        if not (math.isfinite(self.mass) and self.mass >= MIN_MASS):
            raise BadInput(f"--mass: {self.mass} is impossible; give {MIN_MASS:g} kg or more")
        if not (math.isfinite(self.speed) and 0 < self.speed <= 1):
            raise BadInput(f"--speed: {self.speed} is out of range; give 0 < F <= 1")
        if not 0 <= self.clearance <= CLEARANCE_CAP:
            raise BadInput(
                f"--clearance: {self.clearance} m is out of range; give 0 to {CLEARANCE_CAP:g}"
            )
        if not 0 <= self.retries <= MAX_RETRIES:
            raise BadInput(
                f"--retries: {_short(self.retries)} is out of range; give 0 to {MAX_RETRIES}"
            )
        self.robot_source()
        self._check_randomization()
        self._check_solver()
        self._check_viewer()
        self._check_gates()

    def _check_gates(self) -> None:
        """Check what the run must reach, and that it can be proved."""
        if not 0 <= self.min_success <= 1:
            raise BadInput(f"--min-success: {self.min_success} is no rate; give 0 <= F <= 1")
        self._check_proof()
        for name, unit in (("max_ik_offset", "m"), ("max_cycle_time", "s")):
            value = getattr(self, name)
            if value is not None and not (math.isfinite(value) and value > 0):
                option = "--" + name.replace("_", "-")
                raise BadInput(f"{option}: {value} is no limit; give a number of {unit} above 0")

    def _check_proof(self) -> None:
        if self.confidence is None and self.stop_early:
            raise BadInput("--stop-early: how sure must the verdict be? give --confidence, as 0.95")
        if self.indifference is not None and not self.stop_early:
            raise BadInput("--indifference: it belongs to --stop-early; give both or neither")
        if self.confidence is None:
            return
        if not 0.5 < self.confidence <= MOST_SURE:
            raise BadInput(
                f"--confidence: {self.confidence} is no confidence; give 0.5 < C < 1, as 0.95"
            )
        rate, width = self.min_success, self.indifference
        if max(rate, 1 - rate) > MOST_SURE:
            why = "needs no proof" if rate < 0.5 else "is proved by no sensible number of cycles"
            raise BadInput(
                f"--confidence: a rate of {rate} {why}; give --min-success, 0 < F < 1, as 0.95"
            )
        if width is not None and not rate < rate + width < 1:
            raise BadInput(
                f"--indifference: {width} is out of range; give more than 0 and less than "
                f"{1 - rate:g}, what is left above --min-success"
            )

    def own_solver(self) -> SolverSource | None:
        """Return where the user's own solver is, None without one.

        Raises:
            BadInput: naming the option.
        """
        if self.ik in SOLVERS:
            return None
        try:
            return SolverSource.parse(self.ik, *SOLVERS)
        except BadInput as error:
            raise BadInput(f"--ik: {error}") from error

    @property
    def scope(self) -> str | None:
        """Where the solver is asked, None for all lines that the planner tries."""
        return self.ik_scope or (None if self.ik in SOLVERS else SCOPES[0])

    def solver_limits(self) -> SolverLimits:
        """Return what the user's own solver may use."""
        return SolverLimits(pose_timeout=self.pose_timeout, time_limit=self.time_limit)

    def _check_solver(self) -> None:
        """Check what concerns the user's own solver."""
        self.own_solver()
        self.solver_limits()
        if self.frame not in FRAMES:
            raise BadInput(f"--frame: no '{self.frame}'; give one of {', '.join(FRAMES)}")
        if self.ik_scope is not None and self.ik_scope not in SCOPES:
            raise BadInput(f"--ik-scope: no '{self.ik_scope}'; give one of {', '.join(SCOPES)}")
        if self.ik_scope is not None and self.ik == "analytic":
            raise BadInput("--ik-scope: the analytic IK plans all legs; name another by --ik")

    def _check_campaign(self) -> None:
        """Check how the cycles are shared out and what is kept of them."""
        if not 1 <= self.episode_cycles <= MAX_CYCLES:
            raise BadInput(
                f"--episode-cycles: {_short(self.episode_cycles)} is out of range; "
                f"give 1 to {MAX_CYCLES}"
            )
        if self.cell == "all" and self.episode_cycles != EPISODE_CYCLES:
            raise BadInput(
                "--episode-cycles: with --cell all an episode is one round; leave it out"
            )
        if not 1 <= self.jobs <= MAX_JOBS:
            raise BadInput(f"--jobs: {_short(self.jobs)} is out of range; give 1 to {MAX_JOBS}")
        if self.backend not in BACKENDS:
            raise BadInput(f"--backend: no '{self.backend}'; give one of {', '.join(BACKENDS)}")
        if self.record not in RECORDS:
            raise BadInput(f"--record: no '{self.record}'; give one of {', '.join(RECORDS)}")
        self.film()
        if self.record == "none" and self.video is not None:
            raise BadInput("--record: a film is drawn from records; give all or failed")
        if self.resume and self.out is None:
            raise BadInput("--resume: which run? name its folder by --out DIR")
        self._check_only_cycle()

    def _check_only_cycle(self) -> None:
        if self.only_cycle is None:
            return
        if not 0 <= self.only_cycle < self.cycles:
            raise BadInput(
                f"--only-cycle: {_short(self.only_cycle)} is no cycle of this run; give 0 to "
                f"{self.cycles - 1}, or the run's --cycles"
            )
        for name in ("resume", "stop_early"):
            if getattr(self, name):
                raise BadInput(f"--only-cycle: leave --{name.replace('_', '-')} out")

    def _check_viewer(self) -> None:
        if self.viewer is None:
            return
        if self.viewer not in VIEWERS:
            raise BadInput(f"--viewer: no '{self.viewer}'; give one of {', '.join(VIEWERS)}")
        if self.jobs > 1 or self.backend != BACKENDS[0]:
            raise BadInput(
                "--viewer: what is watched is played in one process; leave --jobs and --backend out"
            )
        check_speed("--viewer-speed", self.viewer_speed)

    def film(self) -> Format:
        """Return the form of the film of --video.

        Raises:
            BadInput: if an option of it is impossible, or no film is asked for.
        """
        form = make_format(cameras=self.camera, size=self.size, fps=self.fps)
        if self.video is None and form != Format():
            raise BadInput("--video: give it as well; --camera, --size and --fps are of a film")
        return form

    def robot_source(self) -> RobotSource:
        """Return where the robot comes from.

        Raises:
            BadInput: if an option is not of the form it must have.
        """
        return RobotSource.from_options(
            robot=self.robot,
            package=self.package,
            xacro_arg=self.xacro_arg,
            gripper=self.gripper,
            base=self.base,
            tip=self.tip,
            joints=self.joints,
            fingers=self.fingers,
        )

    def randomization(self) -> Randomization | None:
        """Return the randomisation block, None without one.

        Raises:
            BadInput: if it cannot be read, naming file, field and remedy.
        """
        return None if self.randomize is None else read_randomization(self.randomize)

    def _check_randomization(self) -> None:
        block = self.randomization()
        if block is not None and "cell" in block.block and self.cell != "random":
            raise block.refused("cell", f"--cell {self.cell} names it as well; leave one away")

    def as_json(self) -> dict[str, Any]:
        """Return the options as plain JSON values."""
        return {
            name: str(value) if isinstance(value, Path) else value
            for name, value in asdict(self).items()
        }

    @classmethod
    @cache
    def metadata(cls) -> dict[str, Any]:
        """Return default, and help, metavar and kind of value, of each option, by field name."""
        hints = get_type_hints(cls)
        return {
            item.name: (item.default, {**item.metadata, "kind": _kind(hints[item.name])})
            for item in fields(cls)
        }


def _kind(hint: Any) -> type:
    """Return int, float, str, bool, Path or tuple for the type of a field."""
    kind = get_args(hint)[0] if isinstance(hint, UnionType) else get_origin(hint) or hint
    return cast(type, kind)


def _short(number: int) -> str:
    text = str(number)
    return text if len(text) <= 24 else f"{text[:20]}... ({len(text)} digits)"


def _is_cell_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 6 and int(text) >= 1
