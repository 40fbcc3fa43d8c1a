"""`radiosity bake`, `verify` and `compare`: bakes without a window, for one file or hundreds, and what they are worth.

The same parser serves `python -m radiosity` (the bpy module) and `blender -b scene.blend --command radiosity` (the
program); `command_arguments.py` has it.

Exit status: 0 done, 1 a file failed, 2 bad arguments, 130 stopped by Ctrl-C.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path

from ..core.errors import RadiosityError, SettingsError
from ..core.settings import BakeSettings
from ..core.verification.verification import LEAST
from .command_arguments import BAD_ARGUMENTS, build_parser, overrides
from .command_tasks import Task, plan_tasks

DONE, FAILED, INTERRUPTED = 0, 1, 130


def main(
    argv: Sequence[str],
    program: str = "python -m radiosity",
    opened: Path | None = None,
    session: AbstractContextManager | None = None,
) -> int:
    """Run the command and return its exit status.

    Parameters
    ----------
    argv : sequence of str
        Arguments after the program's name.
    program : str
        How the command was called, for usage texts.
    opened : Path or None
        The scene file that Blender has open, which is baked when no other is named.
    session : context manager or None
        Entered when the arguments are in order and Blender is needed: registers the add-on where it is not.
    """
    parser = build_parser(program, may_be_open=opened is not None)
    try:
        arguments = parser.parse_args(argv)
        try:
            tasks = plan_tasks(arguments, opened)
        except ValueError as error:
            parser.error(str(error))
    except SystemExit as end:  # argparse's own way out, for --help and for errors; inside Blender it must not end all
        return end.code if isinstance(end.code, int) else BAD_ARGUMENTS

    from .adapters.console import own_output  # after the checks: Blender takes a second to load

    with own_output(arguments.verbose) as stream, session or nullcontext(), _interruptible():
        try:
            if arguments.command == "verify":
                _check_verify(arguments)
                return _run(tasks, partial(_verify, arguments=arguments), stream)
            given = overrides(arguments)
            _check(given)
            if arguments.command == "compare":
                _check_compare(arguments)
                return _run(tasks, partial(_compare, given=given, arguments=arguments), stream)
            return _run(tasks, partial(_bake, given=given, arguments=arguments), stream)
        except SettingsError as error:
            sys.stderr.write(f"{program}: error: {error}\n")
            return BAD_ARGUMENTS
        except KeyboardInterrupt:
            sys.stderr.write("radiosity: stopped; what was not finished was not written\n")
            return INTERRUPTED
        except BrokenPipeError:  # nobody reads progress and errors any more
            _discard(sys.stderr)
            return FAILED


def _check(given: dict[str, object]) -> None:
    """Raise SettingsError for a value out of range before the first file is opened."""
    import bpy

    from .adapters.bake_settings import bake_options

    bake_options(bpy.context.scene.radiosity, **given)


def _check_verify(arguments: argparse.Namespace) -> None:
    """Raise SettingsError for a value out of range before the first file is opened."""
    if arguments.places < LEAST:
        raise SettingsError(f"--places must be {LEAST} or more, not {arguments.places}")
    if (arguments.threads or 0) < 0 or arguments.seed < 0:
        raise SettingsError("--threads and --seed must be 0 or more")


def _check_compare(arguments: argparse.Namespace) -> None:
    """Raise SettingsError for a value out of range before the first file is opened."""
    if arguments.places < LEAST:
        raise SettingsError(f"--places must be {LEAST} or more, not {arguments.places}")
    for accuracy in arguments.accuracies or ():
        BakeSettings(accuracy=accuracy)


def _run(tasks: list[Task], work: Callable[[Task], str], stream) -> int:
    """Do the work of each task and show the line it returns; a file that fails does not stop the others."""
    import bpy

    failed = []
    for task in tasks:
        label = str(task.source or bpy.data.filepath or "the open scene")
        try:
            _tell(stream, work(task))
        except (RadiosityError, OSError) as error:
            failed.append(label)
            sys.stderr.write(f"radiosity: error: {_one_line(label, error)}\n")
            sys.stderr.flush()
    if failed and len(tasks) > 1:
        sys.stderr.write(f"radiosity: {len(failed)} of {len(tasks)} files failed: {', '.join(failed)}\n")
    return FAILED if failed else DONE


def _tell(stream, line: str) -> None:
    """Write a result line; that its reader has left, as `head` does, is no reason to stop baking."""
    try:
        stream.write(f"{line}\n")
        stream.flush()
    except BrokenPipeError:
        _discard(stream)


def _discard(stream) -> None:
    """Lead a stream to nowhere, with what it still holds."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _one_line(label: str, message: Exception | str) -> str:
    text = " ".join(str(message).split())
    return text if label in text else f"{label}: {text}"


def _bake(task: Task, given: dict[str, object], arguments: argparse.Namespace) -> str:
    """Bake one file, write what was named, and say so in one line."""
    import bpy

    from .adapters.bake_job import bake_job_steps
    from .adapters.bake_settings import bake_options
    from .adapters.console import ProgressLine
    from .adapters.picture import render_baked_picture
    from .adapters.scene_files import open_scene, save_scene, write_all_or_nothing
    from .adapters.stored_state import leave_edit_mode, receiving
    from .adapters.verify_job import verify_job_steps

    line = ProgressLine(task.source.name if task.source else "radiosity", sys.stderr)
    try:
        if task.source:
            line.update(0.0, "Opening")
            open_scene(task.source, arguments.enable_scripts)
        context = bpy.context
        options = bake_options(context.scene.radiosity, **given)
        leave_edit_mode(context)
        with receiving(context, arguments.selected):
            report = _finished(bake_job_steps(context, options), line)
        if arguments.verify:
            report = _finished(verify_job_steps(context, seed=options.settings.seed), line)
        line.update(1.0, "Writing")
        writers = {}
        if task.output:
            writers[task.output] = save_scene
        if task.report:
            writers[task.report] = _report_writer(report)
        if task.image:
            writers[task.image] = lambda path: render_baked_picture(
                context,
                path,
                options.attribute_name,
                threads=options.settings.threads,
                world_strength=options.world_strength,
            )
        write_all_or_nothing(writers)
    finally:
        line.clear()
    name = str(task.source or bpy.data.filepath)
    for warning in report["warnings"]:
        sys.stderr.write(f"radiosity: warning: {_one_line(name, warning)}\n")
    sys.stderr.flush()
    return f"{name}: {_summary(report)} -> {', '.join(str(path) for path in task.results)}"


def _report_writer(report: dict) -> Callable[[Path], object]:
    text = json.dumps(report, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return partial(Path.write_text, data=text, encoding="utf-8")


def _verify(task: Task, arguments: argparse.Namespace) -> str:
    """Measure the error of one file, write the report if it was named, and say so in one line."""
    import bpy

    from .adapters.console import ProgressLine
    from .adapters.scene_files import open_scene, write_all_or_nothing
    from .adapters.stored_state import leave_edit_mode
    from .adapters.verify_job import verify_job_steps

    line = ProgressLine(task.source.name if task.source else "radiosity", sys.stderr)
    try:
        if task.source:
            line.update(0.0, "Opening")
            open_scene(task.source, arguments.enable_scripts)
        leave_edit_mode(bpy.context)
        steps = verify_job_steps(bpy.context, arguments.places, arguments.seed, arguments.threads)
        report = _finished(steps, line)
        if task.report:
            write_all_or_nothing({task.report: _report_writer(report)})
    finally:
        line.clear()
    written = f" -> {task.report}" if task.report else ""
    places, noise = report["measured_places"], report["measured_noise"]
    return (
        f"{task.source or bpy.data.filepath}: {_measured(report)} at {places:,} vertices, "
        f"reference known to {noise:.1%} at each{written}"
    )


def _compare(task: Task, given: dict[str, object], arguments: argparse.Namespace) -> str:
    """Bake one file by every method and say in a line each what it is worth; write table and plot if named."""
    import bpy

    from .adapters.bake_settings import bake_options
    from .adapters.compare_job import advice, compare_job_steps, comparison_picture, comparison_table, trial_line
    from .adapters.console import ProgressLine
    from .adapters.picture_file import write_picture
    from .adapters.scene_files import open_scene, write_all_or_nothing
    from .adapters.stored_state import leave_edit_mode, receiving

    line = ProgressLine(task.source.name if task.source else "radiosity", sys.stderr)
    try:
        if task.source:
            line.update(0.0, "Opening")
            open_scene(task.source, arguments.enable_scripts)
        context = bpy.context
        options = bake_options(context.scene.radiosity, **given)
        leave_edit_mode(context)
        with receiving(context, arguments.selected):
            steps = compare_job_steps(context, options, arguments.methods, arguments.accuracies, arguments.places)
            comparison = _finished(steps, line)
        name = str(task.source or bpy.data.filepath)
        writers = {}
        if task.table:
            writers[task.table] = partial(Path.write_text, data=comparison_table(comparison), encoding="utf-8")
        if task.image:
            picture = comparison_picture(comparison, Path(name).name)
            if picture is None:
                raise RadiosityError(f"{name}: there is nothing to plot, {advice(comparison)}")
            writers[task.image] = partial(write_picture, pixels=picture)
        write_all_or_nothing(writers)
    finally:
        line.clear()
    written = f" -> {', '.join(str(path) for path in task.results)}" if task.results else ""
    lines = [*(trial_line(trial) for trial in comparison["trials"]), advice(comparison) + written]
    return "\n".join(f"{name}: {text}" for text in lines)


def _finished(steps: Generator, line) -> dict:
    """Run a job to its end and show how far it is; returns the report."""
    while True:
        try:
            progress = next(steps)
        except StopIteration as end:
            return end.value
        line.update(progress.fraction, progress.message)


def _summary(report: dict) -> str:
    """One line with the numbers that say whether it went well."""
    scene, seconds, error = report["scene"], report["seconds"]["total"], report["estimated_error"]
    accuracy = "" if error is None else f", estimated error {error:.1%}"
    if "measured_error" in report:
        accuracy += f", {_measured(report)}"
    return f"baked {scene['baked_objects']} objects, {scene['receivers']:,} receivers in {seconds:.1f} s{accuracy}"


def _measured(report: dict) -> str:
    low, high = report["measured_error_low"], report["measured_error_high"]
    return f"measured error {report['measured_error']:.2%} (95 % interval {low:.2%} to {high:.2%})"


@contextmanager
def _interruptible() -> Iterator[None]:
    """Ctrl-C raises KeyboardInterrupt, also in the program, which otherwise only sets a flag of its own."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        # None means a handler that Python did not set and cannot put back; the process is about to end.
        signal.signal(signal.SIGINT, before if before is not None else signal.SIG_DFL)


_handle = None


def _main_in_blender(argv: list[str]) -> int:
    import bpy

    opened = Path(bpy.data.filepath) if bpy.data.filepath else None
    return main(argv, "blender -b SCENE.blend --command radiosity", opened)


def register() -> None:
    """Make `blender --command radiosity` known."""
    global _handle
    import bpy

    _handle = bpy.utils.register_cli_command("radiosity", _main_in_blender)


def unregister() -> None:
    """Take the command back."""
    global _handle
    import bpy

    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None
