"""The command line: parses, runs a command, and returns its exit code.

Exit codes: 0 done, 1 bad input or failed work (one line on stderr; under ``--json`` an object with
``error``, ``file`` and ``advice`` on stdout) or damage that a check found (its whole report), 2
wrong usage, 130 interrupted, 141 when the reader of the output has closed it, 143 and 129 ended by
SIGTERM and SIGHUP.
"""

import atexit
import importlib.metadata
import io
import json
import os
import sys
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

import tyro

from fusion_core.freed_memory import keep_freed_memory
from fusion_core.model.errors import ScanLoomError
from fusion_core.model.names import escape_undecodable_values, printable
from scanloom.commands.batch import Batch, split_options
from scanloom.commands.calibrate import Calibrate
from scanloom.commands.evaluate import Evaluate
from scanloom.commands.interruption import Terminated, termination
from scanloom.commands.labels import Labels
from scanloom.commands.options import PARSER_CONFIG, WrongUsage
from scanloom.commands.subcommands import Scanloom
from scanloom.commands.terminal import progress_on_stderr

# As long as a path may be; longer numbers Python refuses to read.
_ARGUMENT_MAX = 4096
_DONE, _FAILED, _WRONG_USAGE, _INTERRUPTED, _BROKEN_PIPE = 0, 1, 2, 130, 141
_ENDED_BY_SIGNAL = 128


def main(args: Sequence[str] | None = None) -> int:
    """Run the command of ``args`` (the process's own by default) and return its exit code.

    Help, and wrong usage that the parser finds, leave by SystemExit.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    keep_freed_memory()
    try:
        with termination():
            code = _run(sys.argv[1:] if args is None else args)
        sys.stdout.flush()
    except Terminated as error:
        sys.stderr.write("ended by a signal\n")
        return _ENDED_BY_SIGNAL + error.number
    except KeyboardInterrupt:
        sys.stderr.write("interrupted\n")
        return _INTERRUPTED
    except OSError as error:
        # Only writing to stdout can end here. The interpreter flushes it once more at exit,
        # and must not fail a second time.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return _BROKEN_PIPE
        sys.stderr.write(f"stdout: {error.strerror}\n")
        return _FAILED
    return code


def _run(args: Sequence[str]) -> int:
    if list(args) == ["--version"]:
        sys.stdout.write(f"scanloom {importlib.metadata.version('scanloom')}\n")
        return _DONE
    if any(len(arg) > _ARGUMENT_MAX for arg in args):
        sys.stderr.write(f"an argument is longer than {_ARGUMENT_MAX} characters\n")
        return _WRONG_USAGE
    args, command_options = split_options(args)
    parsed = tyro.cli(Scanloom, prog="scanloom", args=args, config=PARSER_CONFIG).command
    if isinstance(parsed, Batch):
        parsed = replace(parsed, command_options=command_options)
    group = parsed.measure if isinstance(parsed, Evaluate) else parsed
    inner = group.target if isinstance(group, Calibrate) else group
    command = inner.action if isinstance(inner, Labels) else inner
    try:
        with progress_on_stderr() as progress:
            report = command.run(progress)
    except WrongUsage as error:
        sys.stderr.write(f"{error}\n")
        return _WRONG_USAGE
    except (ScanLoomError, OSError) as error:
        _print_failure(error, as_json=command.json)
        return _FAILED
    if report is None:
        return _DONE
    if command.json:
        sys.stdout.write(
            json.dumps(escape_undecodable_values(report.result), indent=2, allow_nan=False) + "\n"
        )
    else:
        sys.stdout.writelines(f"{printable(line)}\n" for line in report.lines)
    return _FAILED if report.failed else _DONE


def _print_failure(error: ScanLoomError | OSError, *, as_json: bool) -> None:
    if isinstance(error, OSError):
        file = None if error.filename is None else str(error.filename)
        error = ScanLoomError(f"{error.strerror or error}.", file=file)
    if as_json:
        result = {"error": error.problem, "file": error.file, "advice": error.advice}
        sys.stdout.write(json.dumps(result, indent=2) + "\n")
    else:
        sys.stderr.write(f"{printable(str(error))}\n")


def run() -> NoReturn:
    """Run the command of the process and end it with the exit code.

    Threads of the workbench may still be deep in compiled code, which the end of the interpreter
    would abort: then the process ends without it, once all that is to be cleaned up is.
    """
    code = main()
    if threading.active_count() > 1:
        atexit._run_exitfuncs()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)
