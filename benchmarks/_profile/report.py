"""The table of one profile."""

from .stages import Profile


def table(name: str, profile: Profile) -> str:
    lines = [
        f"{name} (compiling takes {profile.compile:.1f} s):",
        "",
        "| stage | ms | MB | floor, ms | ratio |",
        "| --- | --- | --- | --- | --- |",
    ]
    for row in profile.rows:
        cells = (
            row.stage,
            f"{1e3 * row.seconds:.3g}",
            f"{row.size / 1e6:.3g}" if row.size else "",
            f"{1e3 * row.floor:.3g}",
            f"{row.seconds / row.floor:.1f}",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])
