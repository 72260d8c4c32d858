"""What the page says of a plan."""

from __future__ import annotations

from html import escape

from gpdf_client import PlanResult, Status

from gpdf_service.viewer.colours import METHODS, NOWHERE, WARNING, css


def answer(result: PlanResult) -> str:
    """Status and reason, or length, time and room."""
    if result.trajectory is None or result.certificate is None:
        return f"**{result.status.value}** · {result.message}"
    path, proof = result.trajectory, result.certificate
    if result.status is not Status.OK:
        return (
            f"**{result.status.value}** · {result.message} ({path.length:.2f} m). "
            "⚠ **Not proven: do not follow it.** It is drawn dashed."
        )
    return (
        f"**{result.status.value}** · {path.length:.2f} m in {path.duration:.1f} s, "
        f"at least **{proof.min_clearance:.2f} m** of room everywhere. {result.message}"
    )


def details(result: PlanResult, seconds: float | None) -> str:
    """What was proven, and where the time went."""
    lines = []
    if (proof := result.certificate) is not None:
        lines += [
            f"| proven | |\n|---|---|\n| room | ≥ {proof.min_clearance:.3f} m |",
            f"| height kept within | {proof.max_height_deviation:.3f} m |",
            f"| highest step | {proof.max_step:.3f} m |",
            f"| steepest ground | {57.29578 * proof.max_slope:.1f}° |",
        ]
    took = "" if seconds is None else f"Answer after {1000 * seconds:.0f} ms. "
    stages = " · ".join(f"{name} {1000 * value:.0f} ms" for name, value in result.timings.items())
    return "\n".join(lines) + f"\n\n{took}{stages}"


def comparison(results: dict[str, PlanResult | str], times: dict[str, float]) -> str:
    """An HTML table of methods in their colours; a text stands for one that the service refused."""
    rows, notes = [], []
    for name, result in results.items():
        swatch = f"<b style='color:{css(METHODS.get(name, NOWHERE))}'>&#9644;</b> {escape(name)}"
        if isinstance(result, str):
            rows.append([swatch, "refused"])
            notes.append(f"{name}: {result}")
            continue
        proven, took = result.status is Status.OK, f"{1000 * times[name]:.0f} ms"
        status = "OK" if proven else f"<b style='color:{css(WARNING)}'>{result.status.value}</b>"
        if result.trajectory is None or result.certificate is None:
            rows.append([swatch, status, "", "", "", took])
        else:
            path, room = result.trajectory, f"{result.certificate.min_clearance:.2f} m"
            rows.append([swatch, status, f"{path.length:.2f} m", room, f"{path.duration:.1f} s", took])
        if not proven:
            drawn = "Dashed, do not follow it. " if result.trajectory is not None else ""
            notes.append(f"{name}: {drawn}{result.message}")
    heads = ["method", "status", "length", "least room", "on the way", "answer"]
    lines = ["".join(f"<th align='left'>{head}</th>" for head in heads)]
    lines += ["".join(f"<td style='padding-right:0.5em'>{cell}</td>" for cell in row) for row in rows]
    table = "".join(f"<tr>{line}</tr>" for line in lines)
    said = "".join(f"<p style='margin:0.5em 0 0'>{escape(note)}</p>" for note in notes)
    return f"<div style='padding:0 1em 0.5em;font-size:0.75em'><table>{table}</table>{said}</div>"


def facts(info: dict[str, object]) -> str:
    """Of a scene, from `Client.scenes`."""
    levels = info.get("levels")
    count = len(levels) if isinstance(levels, list) else 0
    sizes = f"{info.get('points', 0):,} points, {count} level{'s' if count != 1 else ''}"
    return f"{sizes}, version {info.get('version', 0)}, digest `{info.get('digest', '')}`"
