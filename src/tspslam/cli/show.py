"""Settings and calibration files: ``tspslam config`` and ``calib``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ..printing import note, say
from ._shared import ConfigOption, ForceOption, JsonOption, PresetOption, SetOption, SizeOption, app

config_app = typer.Typer(help="Settings.", no_args_is_help=True)
app.add_typer(config_app, name="config")
calib_app = typer.Typer(help="Calibration files.", no_args_is_help=True)
app.add_typer(calib_app, name="calib")


@config_app.command("show")
def config_show_command(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="NAME", help="Of these settings, or stages, all that is known.")
    ] = None,
    preset: PresetOption = "default",
    config: ConfigOption = None,
    assignments: SetOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show every setting: its value, unit and range, and where the value came from."""
    from ..run import config as configuration

    rows = configuration.describe(configuration.resolve(preset, config, assignments or []), names or [])
    say(*([json.dumps(rows, sort_keys=True)] if as_json else configuration.tabulate(rows, has_notes=bool(names))))


@calib_app.command("show")
def calib_show_command(
    file: Annotated[Path, typer.Argument(help="Calibration of ours or of another program.")],
    size: SizeOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show what was understood of a calibration file: every value, and the key of the file that it came from."""
    from ..vision.calibration.show import described, unit_of

    found = described(file, _size(size))
    if as_json:
        say(json.dumps(found, sort_keys=True))
        return
    say(f"{file}: {found['format']}, {found['kind']}")
    width = max(map(len, found["values"]))
    for name, row in found["values"].items():
        lines = row["value"] if isinstance(row["value"], list) else [row["value"]]
        for line in lines:
            shown = "  ".join(f"{number:.9g}" for number in line) if isinstance(line, list) else str(line)
            say(f"{name:<{width}}  {f'{shown} {unit_of(name)}':<22}  {row['origin']}")
    for remark in found["remarks"]:
        say(f"note: {remark}")


@calib_app.command("convert")
def calib_convert_command(
    file: Annotated[Path, typer.Argument(help="Calibration of any kind that `calib show` understands.")],
    output: Annotated[Path, typer.Argument(help="File to write; a folder for ros and colmap.")],
    to: Annotated[str, typer.Option(metavar="FORMAT", help="ours, kalibr, opencv, ros or colmap.")] = "ours",
    size: SizeOption = None,
    rectify: Annotated[bool, typer.Option("--rectify", help="Of raw cameras: the rectified pair.")] = False,
    field_of_view: Annotated[
        float | None, typer.Option("--fov", min=1, max=170, help="Across the rectified image, degrees; in ours alone.")
    ] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Write a calibration file in our format or in that of another program."""
    from ..run.calibration import FORMATS, convert

    if to not in FORMATS:
        raise typer.BadParameter(f"{to!r}, expected one of {', '.join(FORMATS)}", param_hint="--to")
    if field_of_view is not None and (to != FORMATS[0] or rectify):
        raise typer.BadParameter(f"goes with raw cameras and --to {FORMATS[0]} alone", param_hint="--fov")
    remarks = convert(file, output, to, size=_size(size), rectify=rectify, field_of_view=field_of_view, is_forced=force)
    for remark in remarks:
        note(f"note: {remark}")
    say(json.dumps({"written": str(output), "remarks": remarks}) if as_json else f"wrote {output}")


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    width, x, height = text.lower().partition("x")
    if not (x and text.isascii() and width.isdecimal() and height.isdecimal() and len(text) < 20):
        raise typer.BadParameter(f"{text!r}, expected WIDTHxHEIGHT in px, such as 1242x375", param_hint="--size")
    return int(width), int(height)
