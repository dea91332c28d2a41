"""Whatever is wrong with a description: exit 2, one line that names it, within seconds."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from robot_files import heavy_arm, turned_arm

from kr210_sim.cli import main

pytestmark = pytest.mark.slow

SECONDS = 10.0

Damage = Callable[[Path], "Path | list[str]"]
"""Writes a damaged robot into a folder; returns its file, or all arguments."""

ENTITIES = '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;"><!ENTITY c "&b;&b;&b;&b;">]>'
XACRO = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'
COLLISION = '<collision>\n      <geometry><mesh filename="meshes/b.stl"/></geometry>'


def urdf(old: str, new: str) -> Damage:
    """Replace a text of the turned arm's URDF, once."""

    def write(folder: Path) -> Path:
        path = turned_arm(folder)
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new, 1))
        return path

    return write


def collision(filename: str) -> Damage:
    return urdf(COLLISION, COLLISION.replace("meshes/b.stl", filename))


def mesh(name: str, content: bytes) -> Damage:
    """Give a collision mesh another file."""

    def write(folder: Path) -> Path:
        path = collision(f"meshes/{name}")(folder)
        assert isinstance(path, Path)
        (folder / "meshes" / name).write_bytes(content)
        return path

    return write


def xacro(body: str) -> Damage:
    def write(folder: Path) -> Path:
        path = folder / "arm.xacro"
        path.write_text(XACRO.format(body))
        return path

    return write


def file(name: str, text: str) -> Damage:
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_text(text)
        return path

    return write


def option(*arguments: str) -> Damage:
    return lambda folder: [str(turned_arm(folder)), *arguments]


def sparse(name: str, megabytes: int) -> Damage:
    def write(folder: Path) -> Path:
        path = mesh("large.stl", b"")(folder) if name == "large.stl" else folder / name
        assert isinstance(path, Path)
        with (path if name != "large.stl" else folder / "meshes" / name).open("wb") as out:
            out.truncate(megabytes * 1_000_000)
        return path

    return write


def linked_outside(folder: Path) -> Path:
    path = collision("meshes/link.stl")(folder)
    assert isinstance(path, Path)
    (folder / "meshes" / "link.stl").symlink_to("/etc/hostname")
    return path


def bomb_in_include(folder: Path) -> Path:
    (folder / "part.xacro").write_text(ENTITIES + "<robot>&c;</robot>")
    path = xacro('<xacro:include filename="part.xacro"/>')(folder)
    assert isinstance(path, Path)
    return path


def missing_mesh_in_package(folder: Path) -> Path:
    path = heavy_arm(folder)
    (folder / "heavy_arm_support" / "meshes" / "collision" / "link_2.stl").unlink()
    return path


def escape_from_package(folder: Path) -> Path:
    path = heavy_arm(folder)
    macro = path.parent / "heavy_arm_macro.xacro"
    text = macro.read_text()
    macro.write_text(text.replace("meshes/collision/", "../../../../../../etc/", 1))
    return path


def full_folder(folder: Path) -> list[str]:
    (folder / "out").mkdir()
    (folder / "out" / "mine.txt").write_text("keep")
    return [str(turned_arm(folder))]


DAE = (
    '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
    '<unit name="x" meter="{}"/><up_axis>Z_UP</up_axis></asset>{}</COLLADA>'
)
INSTANCES = "<library_nodes>" + "".join(
    f'<node id="n{i}"><instance_node url="#n{i + 1}"/><instance_node url="#n{i + 1}"/></node>'
    for i in range(60)
)
INSTANCES += '<node id="n60"/></library_nodes>'
ONE_TRIANGLE = b"\0" * 80 + struct.pack("<I", 1)

CASES: dict[str, tuple[Damage, str]] = {
    # files and XML
    "no such file": (lambda folder: folder / "gone.urdf", "gone.urdf"),
    "a folder": (lambda folder: folder, "no file"),
    "no XML": (file("a.urdf", "robot: arm"), "XML"),
    "another root": (file("a.urdf", "<sdf/>"), "<sdf>"),
    "no links": (file("a.urdf", "<robot name='x'/>"), "<link>"),
    "an unknown encoding": (file("a.urdf", '<?xml version="1.0" encoding="x"?><robot/>'), "XML"),
    "entity bomb": (file("a.urdf", ENTITIES + "<robot>&c;</robot>"), "entity"),
    "entity bomb in a xacro": (file("a.xacro", ENTITIES + "<robot>&c;</robot>"), "entity"),
    "entity bomb in an include": (bomb_in_include, "entity"),
    "an outer entity": (
        file("a.urdf", '<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/hostname">]><r>&x;</r>'),
        "entity",
    ),
    "deep nesting": (file("a.urdf", "<a>" * 100_000), "nest"),
    "a huge description": (sparse("a.urdf", 200), "MB"),
    # xacro
    "a xacro that never ends": (
        xacro(
            '<xacro:macro name="m" params="n"><xacro:if value="${n}"><xacro:m n="${n - 1}"/>'
            '<xacro:m n="${n - 1}"/></xacro:if></xacro:macro><xacro:m n="60"/>'
        ),
        "within",
    ),
    "an endless number": (xacro('<link name="${10 ** 10 ** 10}"/>'), "xacro"),
    "a text that fills the memory": (xacro("<link name=\"${'a' * 10 ** 10}\"/>"), "memory"),
    "endless recursion": (
        xacro('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>'),
        "recursion",
    ),
    "an include outside": (
        xacro('<xacro:include filename="../../../../../../../etc/hostname"/>'),
        "outside",
    ),
    "an absolute include": (xacro('<xacro:include filename="/etc/hostname"/>'), "outside"),
    "YAML outside": (
        xacro("<xacro:property name='y' value=\"${xacro.load_yaml('/etc/hostname')}\"/>${y}"),
        "outside",
    ),
    "an unknown package": (xacro('<xacro:include filename="$(find nowhere)/a"/>'), "--package"),
    "an undefined argument": (xacro('<link name="$(arg side)"/>'), "--xacro-arg"),
    # mesh paths
    "a missing collision mesh": (collision("meshes/gone.stl"), "gone.stl"),
    "a missing mesh in a package": (missing_mesh_in_package, "link_2.stl"),
    "a package of no one": (collision("package://nowhere/a.stl"), "--package"),
    "a path out of the package": (escape_from_package, "outside"),
    "a relative path outside": (collision("../../../../../../../etc/hostname"), "outside"),
    "a file path outside": (collision("file:///etc/hostname"), "outside"),
    "a link to the outside": (linked_outside, "outside"),
    "a mesh on the web": (collision("http://127.0.0.1/a.stl"), "package://"),
    "a NUL in a path": (collision("a%00.stl"), "a%00.stl"),
    "no mesh name": (urdf(' filename="meshes/b.stl"', ""), "filename"),
    # mesh contents
    "a mesh of 150 MB": (sparse("large.stl", 150), "MB"),
    "an unknown format": (mesh("b.blend", b"BLENDER"), "b.blend"),
    "an empty STL": (mesh("e.stl", b""), "e.stl"),
    "an STL cut short": (mesh("t.stl", ONE_TRIANGLE + b"\0" * 10), "t.stl"),
    "an STL that promises too much": (
        mesh("p.stl", b"\0" * 80 + struct.pack("<I", 4_000_000_000)),
        "p.stl",
    ),
    "an STL of no numbers": (
        mesh("n.stl", ONE_TRIANGLE + struct.pack("<12f", *[float("nan")] * 12) + b"\0\0"),
        "n.stl",
    ),
    "an OBJ without triangles": (mesh("v.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"), "v.obj"),
    "an OBJ with wrong indices": (mesh("i.obj", b"v 0 0 0\nf 1 2 9\n"), "i.obj"),
    "no DAE": (mesh("x.dae", b"<COLLADA"), "x.dae"),
    "an empty DAE": (mesh("x.dae", DAE.format(1, "").encode()), "x.dae"),
    "a DAE of no unit": (mesh("x.dae", DAE.format(0, "").encode()), "x.dae"),
    "entity bomb in a DAE": (mesh("x.dae", (ENTITIES + "<COLLADA>&c;</COLLADA>").encode()), "enti"),
    "a DAE of endless instances": (mesh("x.dae", DAE.format(1, INSTANCES).encode()), "nodes"),
    "a mesh scale of 0": (urdf('"meshes/b.stl"/>', '"meshes/b.stl" scale="1 0 1"/>'), "scale"),
    # the tree and its numbers
    "two roots": (urdf("</robot>", '<link name="stray"/></robot>'), "stray"),
    "a loop": (urdf('<child link="arm/a"/>', '<child link="arm/pedestal"/>'), "arm/"),
    "a name with a control character": (
        urdf('<link name="arm/b">', '<link name="a&#10;b">'),
        "contr",
    ),
    "a name too long": (urdf('<link name="arm/b">', f'<link name="{"b" * 5000}">'), "long"),
    "a chain too deep": (
        urdf(
            "</robot>",
            "".join(
                f'<link name="l{n}"/><joint name="f{n}" type="fixed"><parent link='
                f'"{f"l{n - 1}" if n else "arm/pedestal"}"/><child link="l{n}"/></joint>'
                for n in range(1500)
            )
            + "</robot>",
        ),
        "deep",
    ),
    "a name used twice": (urdf('<link name="arm/b">', '<link name="arm/a">'), "arm/a"),
    "an impossible origin": (urdf('<origin xyz="0 -1.2 0"', '<origin xyz="0 nan 0"'), "arm/j3"),
    "an impossible mass": (urdf('<mass value="80"/>', '<mass value="-80"/>'), "arm/b"),
    "an impossible limit": (urdf('upper="1.5"', 'upper="-1.5"'), "arm/j2"),
    "an arm of five joints": (urdf('"arm/j4" type="revolute"', '"arm/j4" type="fixed"'), "six"),
    "no spherical wrist": (urdf('<origin xyz="0 0.2 0"', '<origin xyz="0.1 0.2 0"'), "IK"),
    # options
    "no folder of a package": (option("--package", "a=/nowhere"), "--package"),
    "a package without a folder": (option("--package", "a"), "--package"),
    "an unknown tip": (option("--tip", "nothing", "--gripper"), "--tip"),
    "a tip before the wrist": (option("--tip", "arm/a", "--gripper"), "--tip"),
    "a path too long": (option("--scene", "s" * 5000), "--scene"),
    "a package path too long": (option("--package", "a=" + "p" * 5000), "--package"),
    "a mesh address that is none": (collision("file://[::1/b.stl"), "b.stl"),
    "an unknown base": (option("--base", "nothing"), "--base"),
    "five joints": (option("--joints", "a,b,c,d,e"), "--joints"),
    "fingers that are not there": (option("--fingers", "a,b"), "--fingers"),
    "a folder that is not empty": (full_folder, "--out"),
    "an unknown scene": (option("--scene", "nowhere"), "--scene"),
}


def test_the_table_is_long_enough():
    assert len(CASES) >= 25


def spent() -> float:
    """Return the processor time of this process and its children [s]: others may be busy."""
    return sum(os.times()[:4])


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_refused_in_one_line_and_in_time(case, tmp_path, capfd):
    damage, word = CASES[case]
    folder = tmp_path / "deep" / "robot"
    folder.mkdir(parents=True)
    damaged = damage(folder)
    arguments = damaged if isinstance(damaged, list) else [str(damaged)]
    started = spent()
    status = main(["convert", *arguments, "-o", str(folder / "out")])
    took = spent() - started
    out, err = capfd.readouterr()
    assert (status, out) == (2, ""), err
    assert err.startswith("kr210-sim: "), err
    assert err.count("\n") == 1, err
    assert word in err
    assert len(err) < 700
    assert took < SECONDS
