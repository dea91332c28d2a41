"""Films and stills: what they show when, that they are whole or absent, and what is refused."""

from __future__ import annotations

import ctypes.util
import json
import os
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest

from kr210_sim.cli import main
from kr210_sim.config import RunConfig
from kr210_sim.exceptions import BadInput
from kr210_sim.film.drawing import draw
from kr210_sim.film.format import VERDICT, Format, check_cameras, make_format
from kr210_sim.film.marks import BAD, SIGN_HEIGHT, SIGN_NEARER, Marks
from kr210_sim.film.overlay import Overlay
from kr210_sim.film.painter import tiles
from kr210_sim.film.take import Take, read_take
from kr210_sim.film.views import aim
from kr210_sim.film.worker import Job
from kr210_sim.playback import load_world
from kr210_sim.results import read_lines
from kr210_sim.video import INSTALL_LINE, draw_stills, film_run, moments_of

SIZE = (320, 180)
DOOR = "import sys; from kr210_sim.cli import main; sys.exit(main())"
NO_GL = {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere", "__EGL_VENDOR_LIBRARY_FILENAMES": "/nowhere"}
"""Environment in which EGL finds no driver."""


@pytest.fixture
def take(default_run) -> Take:
    score = next(read_lines(default_run.out))
    return read_take(default_run.out, score, cycles=10, succeeded=0)


def failed(take: Take, time: float) -> Take:
    """A cycle that fails at a time [s]."""
    cause = {
        "success": False, "reason": "dropped", "failed_stage": "MOVE_TO_PLACE",
        "failed_time_s": time, "detail": "a finger lost the target",
    }  # fmt: skip
    return Take(score=take.score | cause, series=take.series, cycles=10, succeeded=0)


# ---- what is shown when ---------------------------------------------------------------------


def test_frames_are_evenly_apart_and_end_with_the_verdict():
    form = Format(fps=10.0, speed=2.0)
    moments = form.moments(3, 4.73)
    times = [time for _, time in moments]
    still = round(VERDICT * 10)
    assert {cycle for cycle, _ in moments} == {3}
    assert times[0] == 0
    np.testing.assert_allclose(np.diff(times[:-still]), 0.2)
    assert times[-still:] == [4.73] * still
    assert times[-still - 1] > 4.73 - 0.2


def test_a_film_shows_every_cycle_that_has_a_record(default_run):
    moments = moments_of(default_run.out, Format(fps=5.0))
    assert list(dict.fromkeys(cycle for cycle, _ in moments)) == list(range(10))
    assert {cycle for cycle, _ in moments_of(default_run.out, Format(), 4)} == {4}


def test_states_between_record_steps_lie_between_them(take):
    step = 200
    before, after = take.series["qpos"][step], take.series["qpos"][step + 1]
    middle = (take.time[step] + take.time[step + 1]) / 2
    np.testing.assert_allclose(take.at("qpos", middle), (before + after) / 2, atol=1e-6)
    np.testing.assert_allclose(take.at("qpos", take.time[step]), before, atol=1e-6)
    np.testing.assert_allclose(take.at("qpos", 1e9), take.series["qpos"][-1], atol=1e-6)
    assert take.at("nothing", 1.0) is None


def test_stages_and_waypoints_are_those_of_the_record(take):
    names = [name for name, _, _ in take.stages]
    assert names[:3] == ["MOVE_TO_PICK", "APPROACH", "CLOSE_GRIPPER"]
    assert take.stages[0][1] == 0
    assert take.stages[-1][2] == take.duration
    for name, begin, end in take.stages:
        assert take.stage((begin + end) / 2) == name
    assert 5 <= len(take.waypoints) <= len(names)


def test_the_trail_is_thin_and_keeps_to_the_path(take):
    points, steps = take.path("tcp_measured")
    measured = np.asarray(take.series["tcp_measured"], dtype=float)[:, :3]
    np.testing.assert_array_equal(points, measured[steps])
    assert len(points) < 0.6 * len(measured)
    assert steps[-1] == len(measured) - 1


def test_a_cycle_in_which_nothing_moved_can_be_shown(take):
    series = {name: take.series[name] for name in ("joint_names", "joint_widths")}
    still = Take(
        score=take.score | {"failed_stage": "MOVE_TO_PICK"}, series=series, cycles=1, succeeded=0
    )
    assert still.stage(0.3) == "MOVE_TO_PICK"
    assert still.at("qpos", 0.3) is None
    assert len(still.waypoints) == len(still.path("tcp_measured")[0]) == 0
    picture = np.zeros((180, 320, 3), dtype=np.uint8)
    Overlay(SIZE, {"overview": (0, 0, *SIZE)}).paint(picture, still, 0.5)
    assert picture.any()


def test_a_finger_presses_on_the_target_towards_the_other(take):
    """The forces are those on the target: each points from its own finger to the other one."""
    force = np.asarray(take.series["grip_force"], dtype=float)
    sizes = np.linalg.norm(force.reshape(-1, 2, 3), axis=2)
    np.testing.assert_allclose(sizes, take.series["finger_force"], rtol=1e-5, atol=1e-3)
    held = np.flatnonzero(take.series["stage"] == 5)[10]
    right, left = force[held].reshape(2, 3) / sizes[held][:, None]
    assert right @ left < -0.9


# ---- the overlay ----------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(1280, 720), (640, 480), (64, 64), (200, 1080)])
def test_the_verdict_appears_at_its_time(take, size):
    lost = failed(take, 2.0)
    overlay = Overlay(size, {"overview": (0, 0, *size)})

    def corner(time: float) -> np.ndarray:
        picture = np.full((size[1], size[0], 3), 128, dtype=np.uint8)
        overlay.paint(picture, lost, time)
        return picture[: max(8, size[1] // 12), -size[0] // 6 :]

    def red(picture: np.ndarray) -> bool:
        return bool(np.any(picture[..., 0].astype(int) - picture[..., 1] > 100))

    assert not red(corner(1.99))
    assert red(corner(2.0))


def test_the_stage_of_a_failure_is_red_on_the_time_line_once_it_has_failed(take):
    overlay = Overlay((1280, 720), {"overview": (0, 0, 1280, 720)})

    def red(shown: Take, time: float) -> np.ndarray:
        picture = np.full((720, 1280, 3), 128, dtype=np.uint8)
        overlay.paint(picture, shown, time)
        line = picture[685].astype(int)  # through the bars of the stages
        return np.flatnonzero(line[:, 0] - line[:, 1] > 100)

    ((begin, end),) = [each[1:] for each in take.stages if each[0] == "MOVE_TO_PLACE"]
    lost = failed(take, end)
    assert not red(take, take.duration).size
    assert not red(lost, end - 0.1).size
    places = 40 + 1200 * np.array([begin, end]) / take.duration  # [pixels]
    np.testing.assert_allclose(red(lost, end)[[0, -1]], places, atol=3)


def test_the_overlay_follows_time_and_leaves_the_middle_alone(take):
    overlay = Overlay((640, 360), {"a": (0, 0, 320, 360), "b": (320, 0, 320, 360)})
    pictures = []
    for time in (1.0, 2.0):
        picture = np.full((360, 640, 3), 200, dtype=np.uint8)
        overlay.paint(picture, take, time)
        assert np.all(picture[120:280, 20:300] == 200)
        pictures.append(picture)
    assert np.any(pictures[0] != pictures[1])


# ---- what is refused ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("size", "1281x720"), ("size", "1280x721"), ("size", "12x10"), ("size", "9999x9998"),
        ("size", "large"), ("size", "1280"), ("size", "-2x4"), ("size", ""),
        ("fps", 0.0), ("fps", float("nan")), ("fps", 1e9),
        ("speed", 0.0), ("speed", float("nan")), ("speed", -1.0), ("speed", 1e9),
    ],
)  # fmt: skip
def test_an_impossible_form_is_refused(option, value):
    with pytest.raises(BadInput, match=f"--{option}"):
        make_format(cameras=(), **{option: value})


def test_an_unknown_camera_is_refused_with_those_there_are():
    with pytest.raises(BadInput, match="'side'; there are front, gripper, free"):
        check_cameras(("front", "side"), ("front", ""), "--camera")
    assert check_cameras((), ("front", "overview"), "") == ("overview",)
    assert check_cameras((), ("front",), "") == ("front",)
    assert check_cameras((), (), "") == ("gripper",)
    with pytest.raises(BadInput, match="17 cameras"):
        check_cameras(("front",) * 17, ("front",), "")


def test_options_of_a_film_need_one():
    with pytest.raises(BadInput, match="--video"):
        RunConfig(fps=10.0)
    assert RunConfig(video="", camera=("gripper",), size="640x360").film().size == (640, 360)


REFUSED = {
    "no run": (["nowhere"], "cycles.jsonl"),
    "no such cycle": (["RUN", "--cycle", "10"], "--cycle"),
    "no such camera": (["RUN", "--camera", "side"], "overview"),
    "odd size": (["RUN", "--size", "101x80"], "--size"),
    "no film": (["RUN", "--out", "film.avi"], "--out"),
    "no folder": (["RUN", "--out", "nowhere/film.mp4"], "--out"),
    "film exists": (["RUN", "--out", "there.mp4"], "exists"),
    "no number": (["RUN", "--fps", "many"], "--fps"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_render_refuses_in_one_line(default_run, tmp_path, monkeypatch, capfd, name):
    monkeypatch.chdir(tmp_path)
    Path("there.mp4").touch()
    arguments, expected = REFUSED[name]
    given = [str(default_run.out) if word == "RUN" else word for word in arguments]
    assert main(["render", *given]) == 2
    out, err = capfd.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert expected in err
    assert [path.name for path in tmp_path.iterdir()] == ["there.mp4"]


def test_a_run_without_records_has_no_film(default_run, tmp_path):
    line = next(read_lines(default_run.out))
    (tmp_path / "cycles.jsonl").write_text(json.dumps(line) + "\n")
    with pytest.raises(BadInput, match="--record all"):
        moments_of(tmp_path, Format())
    (tmp_path / "cycles").mkdir()
    (tmp_path / "cycles" / "0000.npz").write_bytes(b"PK broken")
    with pytest.raises(BadInput, match=r"0000\.npz is damaged"):
        moments_of(tmp_path, Format())


def test_a_film_that_cannot_be_written_leaves_nothing(default_run, tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        film_run(default_run.out, tmp_path / "nowhere" / "film.mp4", Format(), backend="egl")
    assert list(tmp_path.iterdir()) == []


# ---- cameras --------------------------------------------------------------------------------


@pytest.mark.parametrize("count", range(1, 17))
def test_the_pictures_of_several_cameras_cover_the_frame_once(count):
    covered = np.zeros((719, 1281), dtype=int)
    for left, top, width, height in tiles(count, (1281, 719)):
        covered[top : top + height, left : left + width] += 1
    assert np.all(covered == 1)
    assert len(tiles(count, (1281, 719))) == count


def test_the_gripper_camera_follows_softly(take, default_run):
    model = load_world(default_run.out, 0)
    T_world_base = np.eye(4)
    T_world_base[:3, 3] = 1.0, 2.0, 0.5
    look = aim("gripper", model, take, T_world_base)
    before = None
    for time in np.arange(0.0, take.duration, 0.04):
        camera = look(time)
        tcp = take.at("tcp_measured", time)[:3] + T_world_base[:3, 3]
        assert np.linalg.norm(camera.lookat - tcp) < 0.5
        now = np.array([*camera.lookat, camera.azimuth / 60, camera.elevation / 60])
        assert before is None or np.linalg.norm(now - before) < 0.3
        before = now


def test_nothing_stands_before_the_sign_of_the_verdict(take, default_run):
    model = load_world(default_run.out, 0)
    data, camera = mujoco.MjData(model), mujoco.MjvCamera()
    mujoco.mj_forward(model, data)
    mujoco.mjv_defaultFreeCamera(model, camera)
    scene = mujoco.MjvScene(model, 2000)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    lost = failed(take, 2.0)
    Marks(lost, np.eye(4), height=720).draw(scene, 2.0)
    eye = np.mean([each.pos for each in scene.camera], axis=0)
    drawn = [geom for geom in scene.geoms[: scene.ngeom] if np.allclose(geom.rgba, BAD)]
    assert len(drawn) == 2  # strokes of the cross
    place = lost.at("tcp_measured", 2.0)[:3] - eye
    place[2] += SIGN_HEIGHT
    for stroke in drawn:
        np.testing.assert_allclose(stroke.pos - eye, SIGN_NEARER * place, atol=1e-5)


# ---- pictures -------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_film_is_whole_and_plays_in_browsers(gl, default_run, tmp_path):
    form = Format(cameras=("overview", "gripper"), size=SIZE, fps=4.0, speed=2.0)
    moments = moments_of(default_run.out, form, 0)
    film, told = tmp_path / "film.mp4", []
    film_run(
        default_run.out, film, form, backend=gl, moments=moments,
        on_frame=lambda index, total: told.append((index, total)),
    )  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
    assert told == [(index, len(moments)) for index in range(len(moments))]
    assert imageio_ffmpeg.count_frames_and_secs(str(film))[0] == len(moments)
    frames = imageio_ffmpeg.read_frames(str(film))
    meta = next(frames)
    assert (meta["size"], meta["codec"]) == (SIZE, "h264")
    assert meta["pix_fmt"].startswith("yuv420p")
    last = np.frombuffer(list(frames)[-1], dtype=np.uint8).reshape(*SIZE[::-1], 3).astype(int)
    corner = last[5:20, -50:]
    assert np.any(corner[..., 1] - corner[..., 0] > 60)  # the green of success


@pytest.mark.slow
def test_pictures_do_not_depend_on_the_number_of_processes(gl, default_run):
    moments = [(0, 0.0), (0, 1.5), (1, 2.5), (1, 9.0)]
    job = Job(out=str(default_run.out), cameras=("overview",), size=SIZE, moments=moments)
    one, two = (list(draw(job, backend=gl, processes=count)) for count in (1, 2))
    for picture, other in zip(one, two, strict=True):
        apart = np.abs(picture.astype(int) - other)
        assert np.max(apart) <= 2  # software OpenGL rounds by the number of its threads
    assert len({picture.tobytes() for picture in one}) == 4

    def cyan(picture: np.ndarray) -> int:
        red, green, blue = np.moveaxis(picture.astype(int), -1, 0)
        return int(np.sum((blue - red > 90) & (green - red > 60)))

    assert cyan(one[3]) > cyan(one[2]) > 20  # the trail


@pytest.mark.slow
def test_stills_are_drawn_and_a_broken_world_is_named(gl, default_run, tmp_path):
    (still,) = draw_stills(default_run.out, [(3, 2.0)], cameras=["free"], size=SIZE, backend=gl)
    assert still.shape == (180, 320, 3)
    assert still.std() > 20
    job = Job(out=str(tmp_path), cameras=("overview",), size=SIZE, moments=[(0, 0.0)])
    with pytest.raises(OSError, match="KeyError"):
        list(draw(job, backend=gl, processes=1))


@pytest.mark.slow
def test_without_opengl_runs_work_and_films_say_what_to_install(default_run, tmp_path):
    if ctypes.util.find_library("OSMesa"):
        pytest.skip("needs a machine without OSMesa, which cannot be hidden")

    def command(*arguments: object) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-c", DOOR, *map(str, arguments)],
            env=os.environ | NO_GL | {"MUJOCO_GL": "osmesa"},
            capture_output=True, text=True, check=False,
        )  # fmt: skip

    for arguments in (("run", "--video", "--out", tmp_path / "a"), ("render", default_run.out)):
        refused = command(*arguments)
        assert refused.returncode == 2, refused.stderr
        assert INSTALL_LINE in refused.stderr
        assert refused.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
    played = command("run", "--cycles", 1, "--out", tmp_path / "b")
    assert played.returncode == 0, played.stderr
