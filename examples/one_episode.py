"""Plan a cycle, then run and score two in one scene.

You should see the motions of the plan with their times, then a line for each cycle, as
`cell 9: success in 4.79 s`. Nothing is written.
"""

import numpy as np

from kr210_sim import RunConfig, build_scene, plan_cycle, run_episode

CONFIG = RunConfig(cycles=2, seed=0)  # the options of `kr210-sim run`, checked the same way


def main() -> None:
    """Print the plan and the scores."""
    scene = build_scene(CONFIG)
    print(f"{scene.name}, {len(scene.cells)} cells")

    for motion in plan_cycle(CONFIG, scene):
        traj = motion.trajectory
        _, qd, _ = traj(np.linspace(0.0, traj.duration, 200))
        fastest = np.rad2deg(np.abs(qd).max())
        print(f"  {' '.join(motion.stages)}: {traj.duration:.2f} s, up to {fastest:.0f} deg/s")

    for score in run_episode(CONFIG, scene):
        cell = score.record.cell
        if score.success:
            print(f"cell {cell}: success in {score.cycle_time_s:.2f} s")
        else:
            print(f"cell {cell}: {score.cause.reason}, {score.cause.detail}")


if __name__ == "__main__":
    main()
