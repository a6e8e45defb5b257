"""Where the time goes: every stage of a fit with its floor, and our times over our peers'.

    python benchmarks/profile.py                # tables, written to results/profile.md
    python benchmarks/profile.py --gate         # fails where a ratio has grown
    python benchmarks/profile.py --baseline     # keep the ratios for the gate

The gate compares ratios of times of one run, never times. Heads are measured where
`MANIREG_DATA` has them; `--curve` leaves them out.
"""

import argparse
import json
import os
import sys
from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_num_cpu_devices", os.cpu_count() or 1)

RESULTS = Path(__file__).parent / "results"
SLACK = (
    1.3  # a ratio may be so many times the baseline's: machines differ, and are noisy
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--gate", action="store_true")
    parser.add_argument("--baseline", action="store_true")
    parser.add_argument("--curve", action="store_true", help="no heads")
    options = parser.parse_args()
    from _profile.first import first_ratios
    from _profile.problems import curve, head
    from _profile.ratios import curve_ratios, head_ratios
    from _profile.report import table
    from _profile.stages import profile

    parts, ratios = [], {}
    for name, setup in (("curve", curve), ("head", head)):
        if name == "head" and options.curve:
            continue
        found = profile(setup())
        parts.append(table(name, found))
        print(parts[-1])
        ratios[f"{name}: Newton iteration / factorisation"] = (
            found.iteration / found.factorisation
        )
    ratios |= first_ratios() | curve_ratios()
    if not options.curve:
        ratios |= head_ratios()
    parts.append("\n".join(f"- {name}: {value:.2f}" for name, value in ratios.items()))
    print(parts[-1])

    baseline = RESULTS / "profile.json"
    if options.gate:
        kept = json.loads(baseline.read_text())
        grown = [
            f"{name}: {value:.2f}, baseline {kept[name]:.2f}"
            for name, value in ratios.items()
            if name in kept and value > SLACK * kept[name]
        ]
        sys.exit("Ratios that have grown:\n" + "\n".join(grown) if grown else 0)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "profile.md").write_text("\n".join([*parts, ""]))
    if options.baseline:
        rounded = {name: round(value, 3) for name, value in ratios.items()}
        baseline.write_text(json.dumps(rounded, indent=1) + "\n")


if __name__ == "__main__":
    main()
