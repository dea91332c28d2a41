"""The command line: the one place that turns errors into exit codes."""

from __future__ import annotations

import argparse
import difflib
import errno
import io
import os
import re
import sys
import traceback
from collections.abc import Sequence
from typing import Any, NoReturn

from kr210_sim.exceptions import BadInput, NotWritten
from kr210_sim.verbs import (
    compare,
    convert,
    dh,
    grade,
    ik,
    render,
    report,
    run,
    view,
)
from kr210_sim.verbs.common import (
    EXIT_BAD_INPUT,
    EXIT_INTERNAL,
    EXIT_INTERRUPTED,
    add_version,
)

_REMEDIES = {
    r"invalid float value: (.*)": r"\1 is no number; give one",
    r"expected one argument$": "its value is missing; give one",
    r"expected (\d+) arguments$": r"give \1 values",
}
"""What argparse says -> what to do."""

_ALONE = ("-h", "--help", "--version")
VERBS = (run, report, render, view, grade, ik, dh, convert, compare)


class _Parser(argparse.ArgumentParser):
    """Argument errors in one line, with exit status 2."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # argparse of Python below 3.14 takes -1e-3 for an option
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?$", re.I)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        # argparse of Python below 3.13 makes an empty list of `--option=--`
        if arg_strings == ["--"] and action.option_strings:
            raise argparse.ArgumentError(action, "expected a value, not --")
        return super()._get_values(action, arg_strings)

    def error(self, message: str) -> NoReturn:
        message = message.replace("argument ", "", 1)
        for said, meant in _REMEDIES.items():
            message = re.sub(said, meant, message)
        raise BadInput(message)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    _mend_streams()
    os.environ["MUJOCO_GL"] = "off"  # else MuJoCo needs a library here that only films need
    try:
        options = _parse(argv)
        return int(options.verb(options))
    except BadInput as error:
        print(f"kr210-sim: {_one_line(str(error))}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt as error:
        print(f"kr210-sim: {str(error) or 'interrupted'}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone, e.g. `| head`
        sys.stdout = open(os.devnull, "w")
        return EXIT_INTERNAL
    except NotWritten as error:
        print(f"kr210-sim: {error}", file=sys.stderr)
        return EXIT_INTERNAL
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:  # only what was given can be: our own names are short
            print(f"kr210-sim: {error.filename}: too long for a file; give a path", file=sys.stderr)
            return EXIT_BAD_INPUT
        print(f"kr210-sim: {error}; what is finished is kept", file=sys.stderr)
        return EXIT_INTERNAL
    except Exception:
        traceback.print_exc()
        print("kr210-sim: internal error, please report the lines above", file=sys.stderr)
        return EXIT_INTERNAL


def _one_line(message: str) -> str:
    """Return a message as one line; what quotes an endless name is cut in the middle."""
    line = " ".join(message.split())
    return line if len(line) <= 600 else f"{line[:250]} ... {line[-250:]}"


def _mend_streams() -> None:
    """Let output go nowhere if a stream is closed, and escape what its encoding does not have."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Read the arguments; one that does not exist is refused with the one likely meant."""
    parser = _parser()
    given = sys.argv[1:] if argv is None else argv
    if not given:
        raise BadInput("VERB: is missing; give run for ten cycles, or see kr210-sim --help")
    verbs = [verb.__name__.rpartition(".")[2] for verb in VERBS]
    if given[0] not in (*verbs, *_ALONE):
        remedy = _meant(given[0], (*verbs, *_ALONE), f"give one of {', '.join(verbs)}")
        raise BadInput(f"VERB: no '{given[0]:.80}'; {remedy}")
    options, unknown = parser.parse_known_args(given)
    if unknown:
        known = ["--help", *re.findall(r"--[a-z][a-z-]*", options.usage())]
        remedy = _meant(unknown[0].partition("=")[0], known, "leave it out, or see --help")
        raise BadInput(f"{' '.join(unknown)}: no such argument; {remedy}")
    return options


def _meant(word: str, known: Sequence[str], otherwise: str) -> str:
    near = difflib.get_close_matches(word, known, n=1)
    return f"did you mean {near[0]}?" if near else otherwise


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="kr210-sim", description="KUKA KR210 pick and place in MuJoCo, scored.")
    add_version(parser)
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    for verb in VERBS:
        verb.add(verbs)
    for each in verbs.choices.values():
        each.set_defaults(usage=each.format_usage)
    return parser
