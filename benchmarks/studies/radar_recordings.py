"""Focus of measured radar data, which the user has: Gotcha phase histories, RADARSAT-1 echoes.

    python -m benchmarks.studies.radar_recordings gotcha/pass1/HH --extent 100 --spacing 0.25
    python -m benchmarks.studies.radar_recordings radarsat.toml

Prints contrast and entropy of the image as it is, with the provider's autofocus records and with each autofocuser, and
what an autofocuser's range error differs from that of the records, without a constant and a slope. For chirped echoes
it prints the estimated Doppler centroid beside the header's.
"""

import argparse
from pathlib import Path

import numpy as np

from sarmitsuba.analysis.image_quality import contrast, entropy
from sarmitsuba.core.errors import DataError
from sarmitsuba.files import read_raw
from sarmitsuba.signal.doppler_estimate import estimate_doppler
from sarmitsuba.signal.focusing import apply_autofocus_records, default_grid, range_compress
from sarmitsuba.signal.focusing.autofocus import AUTOFOCUSERS, AutofocusTask, correct_ranges, remove_trend
from sarmitsuba.signal.focusing.focuser import parse_focuser
from sarmitsuba.signal.focusing.windows import parse_window
from sarmitsuba.signal.image import SarImage
from tests.support.unweighted import focus

METHODS = ("phase_gradient",)


def row(name: str, image: SarImage, note: str = "") -> None:
    """Print contrast and entropy of an image."""
    power = image.rcs()
    print(f"{name:<24} contrast {contrast(power):8.3f}   entropy {entropy(power):8.3f} nats   {note}")


def main() -> None:
    """Focus the data and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "data", type=Path, help="file or folder of phase histories, or header of chirped echoes"
    )
    parser.add_argument("--extent", type=float, default=0.0, help="of the image, m; default: the data's own")
    parser.add_argument("--spacing", type=float, default=0.0, help="of the pixels, m; default: half a cell")
    parser.add_argument("--autofocus", nargs="*", default=METHODS, choices=AUTOFOCUSERS.names)
    args = parser.parse_args()
    raw = read_raw(args.data)
    chirped = raw.domain == "chirped"
    if chirped:
        wave, track = raw.radar.waveform, raw.radar.track
        told = 2.0 / wave.wavelength * float(track.velocity[0] @ raw.radar.pointing.boresight[0])
        rate = raw.radar.window.sampling_rate
        try:
            found = str(estimate_doppler(raw.total(), track.prf, wave.center_frequency, rate, wave.bandwidth))
        except DataError as error:
            found = str(error)
        print(f"Doppler centroid {told:.1f} Hz; {found}")
    raw = range_compress(raw, method="flat")
    request: dict[str, object] = {}
    if args.extent:
        request |= {"extent_azimuth": args.extent, "extent_range": args.extent}
    if args.spacing:
        request |= {"spacing_azimuth": args.spacing, "spacing_range": args.spacing}
    row("as recorded", focus(raw, request=request))
    truth = None
    if raw.autofocus_records:
        truth = next(iter(raw.autofocus_records.values())).range_error(raw.radar.waveform.wavelength)
        row("autofocus records", focus(apply_autofocus_records(raw), request=request))
    window, weight = parse_window("rectangular"), np.ones(raw.radar.track.n_pulses)
    for name in () if chirped else args.autofocus:
        task = AutofocusTask(raw, default_grid(raw, request), parse_focuser("backprojection"), window, window)
        error = AUTOFOCUSERS[name].estimate(task)
        note = ""
        if truth is not None:
            left = remove_trend(raw.radar, error - truth, weight)
            whole = remove_trend(raw.radar, truth, weight)
            note = f"off the records by {1e3 * left.std():.2f} of {1e3 * whole.std():.2f} mm rms"
        row(name, focus(correct_ranges(raw, error), request=request), note)


if __name__ == "__main__":
    main()
