"""What a process may do that runs foreign code: limits that the kernel keeps, as far as it can."""

from __future__ import annotations

import ctypes
import errno
import os
import platform
import resource
import struct
import sys
from pathlib import Path
from typing import Any

_SET_DEATH_SIGNAL, _SET_SECCOMP, _SET_NO_NEW_PRIVILEGES = 1, 22, 38  # of prctl(2)
_SIGKILL = 9
_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # system calls of Landlock

_WRITE_FILE, _REFER, _TRUNCATE = 1 << 1, 1 << 13, 1 << 14
_WRITING = _WRITE_FILE | sum(1 << bit for bit in range(4, 13))  # remove and make anything
_SINCE = {2: _REFER, 3: _TRUNCATE}
"""Rights of Landlock that an older kernel does not know, by the version that brought them."""

_MAY_READ = 1 << 2
"""CAP_DAC_READ_SEARCH: libraries may be in the folder of another user."""

_CALLS = {
    "x86_64": {
        "arch": 0xC000003E, "clone": 56, "clone3": 435, "socket": 41, "prlimit": 302,
        "refused": (57, 58, 62, 200, 234, 129, 297, 424, 101, 310, 311, 425),
    },
    "aarch64": {
        "arch": 0xC00000B7, "clone": 220, "clone3": 435, "socket": 198, "prlimit": 261,
        "refused": (129, 130, 131, 138, 240, 424, 117, 270, 271, 425),
    },
}  # fmt: skip
"""System calls by machine; refused: fork, vfork, kill, tkill, tgkill, the two that queue signals,
pidfd_send_signal, ptrace, access to another process's memory, and io_uring, which makes sockets
without the call for it. To set the limits of another process is to end it, too."""

_THREAD, _LOCAL = 0x10000, 1  # CLONE_THREAD, AF_UNIX
_ALLOW, _REFUSE, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_LOAD, _IF_EQUAL, _IF_SET, _IF_ABOVE, _RETURN = 0x20, 0x15, 0x45, 0x35, 0x06


def confine(*, scratch: Path, memory: int, file_size: int, cpu_seconds: int) -> dict[str, str]:
    """Confine this process and all that it starts, for good.

    Args:
        scratch: the only folder in which it may write.
        memory: it may allocate [bytes].
        file_size: of the largest file it may write [bytes].
        cpu_seconds: processor time after which it is killed, whatever becomes of its parent [s].

    Returns:
        What is kept away from it -> by what, or why it is not.
    """
    kept = {"memory": _limit(memory, file_size, cpu_seconds)}
    if not sys.platform.startswith("linux"):
        reason = f"not enforced on {sys.platform}"
        return kept | dict.fromkeys(("files", "processes", "network"), reason)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(_SET_DEATH_SIGNAL, _SIGKILL, 0, 0, 0)
    libc.prctl(_SET_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    kept["capabilities"] = _drop_capabilities(libc)
    kept["files"] = _allow_writing(libc, scratch)
    kept["processes"] = kept["network"] = _filter_calls(libc)
    return kept


def _limit(memory: int, file_size: int, cpu_seconds: int) -> str:
    wanted = {
        resource.RLIMIT_DATA: memory,
        resource.RLIMIT_AS: memory + (2 << 30),  # shared libraries and files are mapped as well
        resource.RLIMIT_FSIZE: file_size,
        resource.RLIMIT_CPU: cpu_seconds,
        resource.RLIMIT_CORE: 0,
    }
    for which, value in wanted.items():
        hard = resource.getrlimit(which)[1]
        value = value if hard == resource.RLIM_INFINITY else min(value, hard)
        try:
            resource.setrlimit(which, (value, value))
        except (OSError, ValueError) as error:
            return f"not enforced: {error}"
    return "resource limits"


def _drop_capabilities(libc: Any) -> str:
    """Give up what makes root more than the owner of its files, but for reading."""
    header = struct.pack("=Ii", 0x20080522, 0)
    held = ctypes.create_string_buffer(24)
    libc.capget(header, held)
    effective, permitted = struct.unpack("=6I", held.raw)[:2]
    kept = struct.pack("=6I", effective & _MAY_READ, permitted & _MAY_READ, 0, 0, 0, 0)
    if libc.capset(header, kept) != 0:
        return f"not dropped: {errno.errorcode.get(ctypes.get_errno(), '?')}"
    return "dropped"


def _allow_writing(libc: Any, scratch: Path) -> str:
    """Refuse to write, make or remove anything outside a folder; /dev/null stays."""
    version = libc.syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), 1)
    if version < 1:
        return "not enforced: this kernel has no Landlock"
    handled = _WRITING | sum(right for since, right in _SINCE.items() if since <= version)
    attributes = struct.pack("=Q", handled)
    ruleset = libc.syscall(_CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), 0)
    if ruleset < 0:
        return "not enforced: Landlock refused"
    of_files = handled & (_WRITE_FILE | _TRUNCATE)
    for path, rights in ((scratch, handled), (Path("/dev/null"), of_files)):
        place = os.open(path, os.O_RDONLY)
        rule = struct.pack("=Qi", rights, place)
        refused = libc.syscall(_ADD_RULE, ruleset, 1, rule, 0) != 0
        os.close(place)
        if refused:
            return "not enforced: Landlock refused a rule"
    if libc.syscall(_RESTRICT_SELF, ruleset, 0) != 0:
        return "not enforced: Landlock refused"
    return f"Landlock, version {version}"


def _filter_calls(libc: Any) -> str:
    """Refuse new processes, signals and limits to others, and sockets beyond this machine."""
    calls = _CALLS.get(platform.machine())
    if calls is None or sys.byteorder != "little":
        return f"not enforced on {platform.machine()}"
    program = _program(calls)
    code = ctypes.create_string_buffer(b"".join(struct.pack("=HBBI", *line) for line in program))
    filter_ = struct.pack("@HP", len(program), ctypes.addressof(code))
    if libc.prctl(_SET_SECCOMP, 2, filter_, 0, 0) != 0:
        return f"not enforced: {errno.errorcode.get(ctypes.get_errno(), '?')}"
    return "seccomp"


def _program(calls: Any) -> list[tuple[int, int, int, int]]:
    """Return the filter in the kernel's own instructions: (code, jump if, jump if not, value)."""
    number, machine, argument = 0, 4, 16  # offsets in seccomp_data
    refuse = (_RETURN, 0, 0, _REFUSE | errno.EPERM)
    lines = [
        (_LOAD, 0, 0, machine),
        (_IF_EQUAL, 1, 0, calls["arch"]),
        (_RETURN, 0, 0, _KILL),
        (_LOAD, 0, 0, number),
        (_IF_ABOVE, 0, 1, 0x40000000),  # another set of numbers for the same calls
        refuse,
        (_IF_EQUAL, 0, 1, calls["clone3"]),
        (_RETURN, 0, 0, _REFUSE | errno.ENOSYS),  # libraries then use clone, which shows its flags
    ]
    for call in calls["refused"]:
        lines += [(_IF_EQUAL, 0, 1, call), refuse]
    lines += [
        (_IF_EQUAL, 0, 3, calls["prlimit"]),
        (_LOAD, 0, 0, argument),
        (_IF_EQUAL, 9, 0, 0),  # its own limits
        refuse,
        (_IF_EQUAL, 0, 3, calls["clone"]),
        (_LOAD, 0, 0, argument),
        (_IF_SET, 5, 0, _THREAD),
        refuse,
        (_IF_EQUAL, 0, 3, calls["socket"]),
        (_LOAD, 0, 0, argument),
        (_IF_EQUAL, 1, 0, _LOCAL),
        refuse,
        (_RETURN, 0, 0, _ALLOW),
    ]
    return lines
