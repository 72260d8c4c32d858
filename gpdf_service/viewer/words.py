"""What the page says of a plan."""

from __future__ import annotations

from gpdf_client import PlanResult, Status


def answer(result: PlanResult) -> str:
    """Status and reason, or length, time and room."""
    if result.trajectory is None or result.certificate is None:
        return f"**{result.status.value}** · {result.message}"
    path, proof = result.trajectory, result.certificate
    if result.status is not Status.OK:
        return f"**{result.status.value}** · {result.message} ({path.length:.2f} m, **not certified**)"
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
    """A table of methods; a text stands for one that the service refused."""
    lines = ["| method | status | length | room | time |", "|---|---|---|---|---|"]
    refused = []
    for name, result in results.items():
        if isinstance(result, str):
            lines.append(f"| {name} | refused | | | |")
            refused.append(f"{name}: {result}")
        elif result.trajectory is None or result.certificate is None:
            lines.append(f"| {name} | {result.status.value} | | | {1000 * times[name]:.0f} ms |")
        else:
            room = f"{result.certificate.min_clearance:.2f} m"
            length = f"{result.trajectory.length:.2f} m"
            lines.append(f"| {name} | {result.status.value} | {length} | {room} | {1000 * times[name]:.0f} ms |")
    return "\n".join(lines) + "".join(f"\n\n{text}" for text in refused)


def facts(info: dict[str, object]) -> str:
    """Of a scene, from `Client.scenes`."""
    levels = info.get("levels")
    count = len(levels) if isinstance(levels, list) else 0
    sizes = f"{info.get('points', 0):,} points, {count} level{'s' if count != 1 else ''}"
    return f"{sizes}, version {info.get('version', 0)}, digest `{info.get('digest', '')}`"
