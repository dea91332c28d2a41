"""Compare `ik` with other inverse kinematics libraries, and print the result as Markdown.

    python benchmarks/ik.py            about a minute
    python benchmarks/ik.py --quick    a tenth of the poses

Peers that are not installed are left out and named (`pip install 'kr210-sim[bench]'`). All of them
get the same KR210 with its tool at gripper_link, and one thread. Times are CPU times of the
process, which leave out what other processes take, as medians over rounds in which every library
takes its turn. Residuals come from a forward chain in extended precision of the bench's own.
"""

from __future__ import annotations

import argparse
import os
import statistics
import sys
import time
from pathlib import Path
from typing import Any

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
here = Path(__file__).resolve().parent
sys.path[0] = str(here.parent)  # in front, since this file must not shadow the library
sys.path.append(str(here))

import numpy as np  # noqa: E402
from ik_peers import AXES, LOWER, ORIGINS, UPPER, VELOCITY, Solver, load_mink, load_peers  # noqa: E402

import ik  # noqa: E402

ARM = ik.KR210
LIMITS = (LOWER, UPPER)


def exact_forward(q: np.ndarray) -> np.ndarray:
    """Multiply the chain out in extended precision: (n, 6) -> (n, 4, 4)."""
    q = np.asarray(q, np.longdouble)
    R = np.broadcast_to(np.eye(3, dtype=np.longdouble), (len(q), 3, 3)).copy()
    p = np.zeros((len(q), 3), np.longdouble)
    for j, origin in enumerate(ORIGINS):
        o = np.array([np.longdouble(str(x)) for x in origin])
        p += (R * o).sum(axis=2)
        if j < 6:
            k = AXES[j].index(1)
            a, b = (k + 1) % 3, (k + 2) % 3
            c, s = np.cos(q[:, j, None]), np.sin(q[:, j, None])
            column_a, column_b = R[:, :, a].copy(), R[:, :, b].copy()
            R[:, :, a], R[:, :, b] = c * column_a + s * column_b, c * column_b - s * column_a
    T = np.zeros((len(q), 4, 4), np.longdouble)
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, p, 1
    return T


def pose_sets(n: int) -> dict[str, np.ndarray]:
    """Ordinary poses, and poses exactly on the singularities."""
    rng = np.random.default_rng(1)
    q = rng.uniform(LOWER, UPPER, (4, n, 6))
    q[1, :, 4] = 0.0
    q[2, :, 2] = -np.pi / 2 - ARM.constants.phi
    sets = [exact_forward(rows).astype(float) for rows in q]
    on_axis = sets[3]
    on_axis[:, :2, 3] = 0.303 * on_axis[:, :2, 0]
    on_axis[:, 2, 3] = rng.uniform(1.0, 3.0, n) + 0.303 * on_axis[:, 2, 0]
    names = ("ordinary", "wrist, q5 = 0", "elbow, stretched", "shoulder, on axis 1")
    return dict(zip(names, sets, strict=True))


def ours() -> list[Solver]:
    """This library, without and with limits."""
    return [
        Solver(
            "ik",
            lambda T: ik.inverse(ARM, T),
            lambda T: ik.inverse(ARM, T),
            lambda T: (s := ik.inverse(ARM, T)).q[s.valid],
        ),
        Solver(
            "ik, limits", lambda T: ik.inverse(ARM, T, LIMITS), lambda T: ik.inverse(ARM, T, LIMITS)
        ),
    ]


def accuracy(solvers: list[Solver], n: int) -> None:
    """Print how many poses and branches each library finds, and its worst residuals."""
    sets = pose_sets(n)
    branches = {name: ik.inverse(ARM, T).valid.sum() for name, T in sets.items()}
    print(f"\n## Accuracy, {n} poses each\n")
    print("Branches that coincide at a singularity count as many; who merges them shows fewer, and")
    print("has lost nothing. Solutions that a library itself calls approximate are left out.\n")
    print("| library | poses | solved | solutions / branches | worst [m] | worst [rad] |")
    print("|---|---|---|---|---|---|")
    for solver in solvers:
        if solver.answers is None:
            continue
        for name, T in sets.items():
            rows = [np.asarray(solver.answers(pose), float).reshape(-1, 6) for pose in T]
            pose = np.repeat(np.arange(n), [len(r) for r in rows])
            solved = np.mean([len(r) > 0 for r in rows])
            back, target = exact_forward(np.concatenate(rows)), T[pose].astype(np.longdouble)
            far = np.sqrt(((back - target)[:, :3, 3] ** 2).sum(axis=1))
            a, b = back[:, :3, :3], target[:, :3, :3]
            twist = 0.5 * np.cross(a, b, axis=1).sum(axis=2)
            angle = np.sqrt((twist**2).sum(axis=1))
            print(
                f"| {solver.name} | {name} | {solved:.1%} | {len(pose) / branches[name]:.3f} | "
                f"{far.max(initial=0):.1e} | {angle.max(initial=0):.1e} |"
            )


def speed(solvers: list[Solver], n: int, rounds: int) -> tuple[dict[str, float], dict[str, float]]:
    """Print the time per pose of one call each, and of one call for all."""
    T = pose_sets(n)["ordinary"]
    some = [pose.copy() for pose in T[:300]]
    single: dict[str, list[float]] = {s.name: [] for s in solvers if s.single}
    batch: dict[str, list[float]] = {s.name: [] for s in solvers if s.batch}
    prepared = {s.name: s.prepare(T) if s.prepare else T for s in solvers if s.batch}
    for i in range(rounds):
        for solver in solvers[i % len(solvers) :] + solvers[: i % len(solvers)]:
            if solver.single:
                start = time.process_time()
                for pose in some:
                    solver.single(pose)
                single[solver.name].append((time.process_time() - start) / len(some) * 1e6)
            if solver.batch:
                start = time.process_time()
                solver.batch(prepared[solver.name])
                batch[solver.name].append((time.process_time() - start) / n * 1e6)
    one = {name: statistics.median(times) for name, times in single.items()}
    many = {name: statistics.median(times) for name, times in batch.items()}
    print(f"\n## CPU time per pose, median of {rounds} rounds [us]\n")
    print(f"| library | one pose | batch of {n} |\n|---|---|---|")
    for solver in solvers:
        cells = [
            f"{times[solver.name]:.2f}" if solver.name in times else "-" for times in (one, many)
        ]
        print(f"| {solver.name} | {cells[0]} | {cells[1]} |")
    return one, many


def ratios(one: dict[str, float], many: dict[str, float]) -> None:
    """Print how the times compare, beside what is aimed at."""

    def find(times: dict[str, float], start: str, end: str = "") -> float:
        found = [t for name, t in times.items() if name.startswith(start) and name.endswith(end)]
        return found[0] if found else float("nan")

    eaik_many, reach = find(many, "EAIK"), find(many, "py-opw", "reach")
    no_sigma = find(many, "py-opw", "no sigma_min")
    ssik_one = find(one, "ssik", "turns)")
    rows = [
        ("batch: EAIK / ik", eaik_many / many["ik"], ">= 4"),
        ("batch: py-opw reach / ik", reach / many["ik"], ">= 10"),
        ("batch: py-opw reach, no sigma_min / ik", no_sigma / many["ik"], ">= 2"),
        ("batch: EAIK / ik with limits", eaik_many / many["ik, limits"], "> 1"),
        (
            "batch: py-opw reach, no sigma_min / ik with limits",
            no_sigma / many["ik, limits"],
            "> 1",
        ),
        ("one pose: ik with limits / EAIK raw", one["ik, limits"] / find(one, "EAIK"), "<= 5"),
        ("one pose: ssik default / ik with limits", ssik_one / one["ik, limits"], ">= 3"),
    ]
    print("\n## Ratios\n\n| | measured | aim |\n|---|---|---|")
    for label, ratio, aim in rows:
        print(f"| {label} | {ratio:.2f} | {aim} |")


def numeric(n: int) -> list[str]:
    """Print how numeric solvers do on random poses; return the missing ones."""
    rng = np.random.default_rng(3)
    T = exact_forward(rng.uniform(LOWER, UPPER, (n, 6))).astype(float)
    restarts = ik.numeric_solver(ARM, LOWER, UPPER)
    alone = ik.numeric_solver(ARM, LOWER, UPPER, options=ik.NumericOptions(restarts=0))
    solvers = [
        ("ik, damped least squares, restarts", lambda T: restarts(T[None], np.zeros(6))[0]),
        ("ik, damped least squares, one start", lambda T: alone(T[None], np.zeros(6))[0]),
        (
            "ik, analytic, nearest to zero",
            lambda T: ik.nearest(ik.inverse(ARM, T).q, 0 * LOWER, *LIMITS),
        ),
    ]
    missing = []
    try:
        solvers.append(load_mink())
    except ImportError as error:
        missing.append(f"mink ({error})")
    print(f"\n## One configuration inside of the limits, from zero, {n} random poses\n")
    print("| solver | found | CPU time per pose [ms] | worst [m] |\n|---|---|---|---|")
    for name, solve in solvers:
        start = time.process_time()
        q = np.array([solve(pose) for pose in T])
        taken = (time.process_time() - start) / n * 1e3
        found = ~np.isnan(q[:, 0]) & ik.within_limits(q, *LIMITS, 1e-6)
        far = np.sqrt(((exact_forward(q[found]) - T[found])[:, :3, 3] ** 2).sum(axis=1))
        print(f"| {name} | {found.mean():.1%} | {taken:.3f} | {far.max(initial=0):.1e} |")
    return missing


def paths(pairs: int, waypoints: int) -> None:
    """Print what the choice of branches and turns along straight lines gains and costs."""
    rng = np.random.default_rng(5)
    chosen: dict[str, list[Any]] = {"best": [], "greedy": []}
    taken = []
    while len(taken) < pairs:
        q_start, T = pick_and_place(waypoints, rng)
        if not ik.inverse(ARM, T, LIMITS).in_limits.any(axis=1).all():
            continue
        start = time.process_time()
        chosen["best"].append(ik.best_sequence(ARM, T, *LIMITS, VELOCITY, q_start))
        taken.append((time.process_time() - start) * 1e3)
        chosen["greedy"].append(ik.greedy_sequence(ARM, T, *LIMITS, VELOCITY, q_start))
    longer = sum(
        b.time > g.time + 1e-9 for b, g in zip(chosen["best"], chosen["greedy"], strict=True)
    )
    print(f"\n## Choice along {pairs} random pick and place lines of {waypoints} waypoints\n")
    print("| choice | joint time, mean [s] | axis 4, mean [rad] | axis 6, mean [rad] | jumps |")
    print("|---|---|---|---|---|")
    for name, results in chosen.items():
        travel = np.mean([r.travel for r in results], axis=0)
        seconds, jumps = np.mean([r.time for r in results]), sum(r.jumps for r in results)
        print(f"| {name} | {seconds:.3f} | {travel[3]:.3f} | {travel[5]:.3f} | {jumps} |")
    median, p90 = np.quantile(taken, (0.5, 0.9))
    print(f"\nBest longer than greedy: {longer} of {pairs}. ", end="")
    print(f"CPU time to choose: median {median:.1f} ms, 90 % below {p90:.1f} ms (aim: 10 ms).")


def pick_and_place(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """A start, and n poses on a line from a shelf in front to a bin at the side."""
    A, B = (
        exact_forward(np.array([[yaw, pitch, 0, roll, 0, 0]]))[0].astype(float)
        for yaw, pitch, roll in (
            rng.uniform((-0.5, -0.4, -0.5), (0.5, 0.4, 0.5)),
            rng.uniform((1.0, -0.5, 0.0), (2.2, 1.2, 0.0)),
        )
    )
    A[:3, 3] = rng.uniform((1.9, -0.9, 0.8), (2.3, 0.9, 2.3))
    B[:3, 3] = rng.uniform((-0.3, 1.9, 1.2), (0.3, 2.3, 1.9))
    R = A[:3, :3].T @ B[:3, :3]
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    angle = np.arctan2(np.linalg.norm(axis), np.trace(R) - 1.0)
    t = np.linspace(0.0, 1.0, n)[:, None]
    turn = ik.chain_frames(np.eye(4)[None], axis[None], angle * t)[:, 0]
    T = A @ turn
    T[:, :3, 3] = A[:3, 3] + t * (B[:3, 3] - A[:3, 3])
    return np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.0]), T


def main() -> None:
    """Run all parts."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="a tenth of the poses")
    quick = parser.parse_args().quick
    peers, missing = load_peers()
    solvers = ours() + peers
    print("# Inverse kinematics of the KR210\n")
    print(f"Python {sys.version.split()[0]}, numpy {np.__version__}")
    speeds = speed(solvers, 2000 if quick else 20_000, 5 if quick else 15)
    ratios(*speeds)
    accuracy(solvers, 100 if quick else 1000)
    missing += numeric(20 if quick else 200)
    paths(20 if quick else 200, 200)
    if missing:
        print(f"\nNot installed: {'; '.join(missing)}")


if __name__ == "__main__":
    main()
