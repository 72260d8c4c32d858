"""What the page says of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

from gpdf_client import PlanResult, Status

from gpdf_service.viewer.colours import WARNING, css

DARK_WARNING = "#9a3d00"
"""As text on its pale ground: 6 to 1, where `WARNING` has less than 4.5."""
HEADS = ("status", "length [m]", "least clearance [m]", "on the way [s]", "answer [s]")


def answer(result: PlanResult) -> str:
    """Status and reason, or length, time and room."""
    if result.trajectory is None or result.certificate is None:
        return f"**{result.status.value}** · {result.message}"
    path, proof = result.trajectory, result.certificate
    if result.status is not Status.OK:
        warning = "⚠ **Not proven: do not follow it.** It is drawn dashed."
        return f"**{result.status.value}** · {path.length:.2f} m. {result.message}\n\n{warning}"
    return (
        f"**{result.status.value}** · {path.length:.2f} m in {path.duration:.1f} s, "
        f"at least **{proof.min_clearance:.2f} m** of clearance everywhere. {result.message}"
    )


def refusal(result: PlanResult) -> str:
    """A card that says why there is no path, as HTML; a screen reader reads it at once."""
    head = f"<b style='color:{DARK_WARNING}'>No path: {escape(result.status.value)}</b>"
    sentence = result.message[:1].upper() + result.message[1:]
    style = (
        f"margin:0 1em 0.5em;padding:0.5em 0.75em;border-left:4px solid {css(WARNING)};background:rgba(213,94,0,.08)"
    )
    return f"<div role='alert' style='{style}'>{head}<br>{escape(sentence)}</div>"


STAGES = {"waited": "in the queue", "search": "search", "optimise": "optimiser", "total": "all of the plan"}
"""Times of an answer as a person reads them; what else is timed is for a log."""


def details(result: PlanResult, seconds: float | None) -> str:
    """What was proven, what the map may miss, and where the time went."""
    lines = []
    if (proof := result.certificate) is not None:
        lines += [
            f"| proven | |\n|---|---|\n| clearance | ≥ {proof.min_clearance:.3f} m |",
            f"| height kept within | {proof.max_height_deviation:.3f} m |",
            f"| highest step | {proof.max_step:.3f} m |",
            f"| steepest ground | {57.29578 * proof.max_slope:.1f}° |",
            f"| things may be missed up to | {proof.hidden_height:.3f} m |",
            f"| ground was seen every | {proof.ground_spacing:.2f} m |",
        ]
    took = "" if seconds is None else f"Answer after {1000 * seconds:.0f} ms. "
    stages = ", ".join(
        f"{said} {1e3 * result.timings[name]:.0f} ms" for name, said in STAGES.items() if name in result.timings
    )
    return "\n".join(lines) + f"\n\n{took}{stages[:1].upper()}{stages[1:]}"


def comparison(
    what: str,
    results: dict[str, PlanResult | str],
    times: dict[str, float],
    shades: Mapping[str, tuple[int, int, int]],
) -> str:
    """An HTML table of plans.

    Args:
        what: Of what they are compared: "method", "body".
        results: By name; a text stands for one that the service refused.
        times: Until the answer [s], by name.
        shades: Colours of their paths, by name.
    """
    rows, notes = [], []
    for name, result in results.items():
        named = f"<b style='color:{css(shades[name])}'>&#9632;</b> {escape(name)}"
        if isinstance(result, str):
            rows.append([named, "refused"])
            notes.append(f"{name}: {result}")
            continue
        path, proof, proven = result.trajectory, result.certificate, result.status is Status.OK
        status = "OK" if proven else f"<b style='color:{DARK_WARNING}'>{result.status.value}</b>"
        numbers = ["", "", ""]
        if path is not None and proof is not None:
            numbers = [f"{path.length:.2f}", f"{proof.min_clearance:.2f}", f"{path.duration:.1f}"]
        rows.append([named, status, *numbers, f"{times[name]:.2f}"])
        if not proven:
            warning = "⚠ Dashed: do not follow it. " if path is not None else ""
            subject = "" if result.message.startswith(name) else f"{name}: "
            notes.append(f"{warning}{subject}{result.message}")
    lines = "".join(_row("td", row) for row in rows)
    said = "".join(f"<p style='margin:0.5em 0 0'>{escape(note)}</p>" for note in notes)
    head = _row("th", (what, *HEADS))
    return f"<div role='status' style='padding:0 1em 0.5em;font-size:0.75em'><table>{head}{lines}</table>{said}</div>"


def _row(kind: str, cells: Sequence[str]) -> str:
    style = "text-align:left;vertical-align:top;padding:0 0.8em 0 0" + (";white-space:nowrap" if kind == "td" else "")
    return "<tr>" + "".join(f"<{kind} style='{style}'>{cell}</{kind}>" for cell in cells) + "</tr>"


def facts(info: dict[str, object]) -> str:
    """Of a scene, from `Client.scenes`."""
    levels = info.get("levels")
    count = len(levels) if isinstance(levels, list) else 0
    sizes = f"{info.get('points', 0):,} points, {count} level{'s' if count != 1 else ''}"
    return f"{sizes}, version {info.get('version', 0)}, digest `{info.get('digest', '')}`"
