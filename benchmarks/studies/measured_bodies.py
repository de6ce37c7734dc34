"""A measured body at one frequency with settings of one's own, against the converged solver of its table.

``python -m benchmarks.studies.measured_bodies duct 7e9 full_wave=on`` prints the rms difference in dB of HH and VV over
the azimuths that the validation compares, the statement of the error, and the processor time. Solved currents of the
duct take 42 000 unknowns in two symmetric parts: 10 GB and ten minutes of two cores.
"""

import argparse
import sys
import time

import numpy as np

from sarmitsuba.machine.memory import peak_memory
from sarmitsuba.truth.validation.cases import measured
from sarmitsuba.truth.validation.measured.azimuth_tables import azimuth_table


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("body", choices=tuple(measured.BODIES))
    parser.add_argument("frequency", type=float, help="Hz, of its table")
    parser.add_argument("setting", nargs="*", metavar="NAME=VALUE", help="such as full_wave=on")
    parser.add_argument("--every", type=int, default=1, help="of these azimuths")
    args = parser.parse_args()
    settings = dict(item.split("=", 1) for item in args.setting)
    body, start = measured.BODIES[args.body], time.process_time()
    sweep = measured.swept(args.body, args.frequency, args.every, settings)
    seconds = time.process_time() - start
    for bound in (b for b in body.bounds if b.frequency == args.frequency):
        found = []
        for channel in measured.CHANNELS:
            table = azimuth_table(body.table, args.frequency, channel)
            azimuth, solver = table.azimuth[:: args.every], table.solver[:: args.every]
            inside = (azimuth >= bound.sector[0]) & (azimuth <= bound.sector[1])
            strong = inside & (solver >= solver[inside].max() - measured.FLOOR)
            found.append(np.sqrt(np.mean(np.square(sweep.dbsm(channel) - solver)[strong])))
        print(f"{args.body}, {bound.label}: rms {found[0]:.2f} / {found[1]:.2f} dB")
    print(sweep.statement.text)
    print(f"{seconds:.0f} processor seconds, {peak_memory() / 1e9:.1f} GB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
