"""Inverse-SAR (turntable) image of a target from a sweep of azimuth: the scene whose rendering it is."""

import dataclasses

import numpy as np

from sarmitsuba.core.constants import SPEED_OF_LIGHT
from sarmitsuba.effects.catalog.full_wave import FULL_WAVE
from sarmitsuba.effects.plan import remove_switch
from sarmitsuba.loading.assemble import seen_by
from sarmitsuba.radar.description import RadarDescription, RadarInput
from sarmitsuba.radar.film import FilmDescription
from sarmitsuba.radar.track import Track
from sarmitsuba.scene.materials.map_materials import list_with_parts
from sarmitsuba.scene.scene import Scene
from sarmitsuba.simulation.execution.rcs import FAR, Aspects, outline_of, target_middle

# resolution cells over the target's diameter, and bandwidth over frequency, where no bandwidth is given
CELLS_ACROSS, WIDEST_BAND = 48.0, 0.4
# aspects of an image relative to the number needed for the target's width, and the largest number
ASPECT_MARGIN, MOST_ASPECTS = 1.25, 4096
# pixel spacing over the Nyquist spacing
PIXEL_FILL = 0.5
# arbitrary speed along the arc
PULSES_PER_SECOND = 100.0
# rad; elevations for which images are made: not from below, nor from straight above, where the target only rotates
LOWEST, HIGHEST = 0.0, float(np.radians(80.0))
# rad; an antenna in the plane of the image is raised by this much
RAISED = 1e-4
# rad; least range of azimuth for an image
LEAST_TURN = float(np.radians(1.0))
# widest step of a turn: aspects farther apart are single ones, whose image takes hundreds of times their own rays
WIDEST_STEP = float(np.radians(5.001))


def image_refusal(aspects: Aspects) -> str:
    """Reason why the aspects give no image; empty where they do."""
    if not aspects.by_azimuth:
        return "only a sweep of azimuth gives an image"
    if np.ptp(aspects.azimuth) < LEAST_TURN:
        return f"the azimuth turns by less than {np.degrees(LEAST_TURN):g} deg"
    step = np.ptp(aspects.azimuth) / (aspects.azimuth.size - 1)
    if step > WIDEST_STEP:
        return f"aspects are {np.degrees(step):.3g} deg apart; steps of {np.degrees(WIDEST_STEP):.0f} deg give one"
    if not LOWEST <= aspects.elevation[0] <= HIGHEST:
        return f"the elevation is not within 0 to {np.degrees(HIGHEST):g} deg"
    return ""


def turntable_scene(
    scene: Scene, aspects: Aspects, *, channels: tuple[str, ...] = (), bandwidth: float = 0.0
) -> Scene:
    r"""Scene with a radar that flies the arc of an azimuth sweep: rendering it gives the target's inverse-SAR image.

    The arc is sampled without aliasing for a target of radius r, at the highest frequency:

    .. math:: \Delta \phi \le \frac{\lambda}{4 r \cos\epsilon}

    Parameters
    ----------
    scene : the target
    aspects : azimuth sweep, see :func:`image_refusal`
    channels : polarisations; empty: those of the scene's radar
    bandwidth : Hz; 0 = 48 cells over the target's diameter, at most 0.4 of the frequency

    Returns
    -------
    scene whose image plane is the horizontal plane through the target's middle; where the whole arc would need more
    than 4096 pulses, the pulses are those about the sweep's middle

    Notes
    -----
    The radar is a thousand radii away. If it lies in the image plane it is raised by 1e-4 rad.
    """
    scene = remove_switch(scene, FULL_WAVE)  # of the sweep alone
    center, radius = target_middle(scene)
    frequency = scene.radar.waveform.center_frequency
    width = float(np.linalg.norm((outline_of(scene) - center)[:, :2], axis=1).max())
    radius, width = max(radius, 1e-3), max(width, 1e-3)
    if not bandwidth:
        bandwidth = min(CELLS_ACROSS * SPEED_OF_LIGHT / (4.0 * radius), WIDEST_BAND * frequency)
    elevation = max(float(aspects.elevation[0]), RAISED)
    shortest = SPEED_OF_LIGHT / (frequency + 0.5 * bandwidth)
    margin = 1.0 + 32.0 / CELLS_ACROSS  # side lobes beside the target
    step = shortest / (4.0 * margin * width * np.cos(elevation)) / ASPECT_MARGIN
    first, last = float(aspects.azimuth.min()), float(aspects.azimuth.max())
    n = int(min(np.ceil((last - first) / step), MOST_ASPECTS - 1)) + 1
    middle, half = 0.5 * (first + last), 0.5 * min(last - first, (n - 1) * step)
    if aspects.whole_circle and n < MOST_ASPECTS:  # seen from the west in the middle, +x is right and +y up
        middle, half = np.pi, np.pi * (1.0 - 1.0 / n)
    azimuth = np.linspace(middle + half, middle - half, n)  # clockwise: the target lies to the right
    arc = Aspects(azimuth, np.full(n, elevation))
    position = center + scene.offset + FAR * radius * arc.directions
    track = Track.from_samples(np.arange(n) / PULSES_PER_SECOND, position)
    extent = 2.0 * margin * width
    longest = SPEED_OF_LIGHT / (frequency - 0.5 * bandwidth)
    spacing = _pixel_spacings(half, elevation, shortest, longest)
    description = RadarInput.of(
        RadarDescription(
            mode="spotlight",
            center_frequency=frequency,
            bandwidth=bandwidth,
            polarisation=",".join(channels or scene.radar.channels),
            aim_x=float(center[0] + scene.offset[0]),
            aim_y=float(center[1] + scene.offset[1]),
            aim_z=float(center[2] + scene.offset[2]),
        ),
        FilmDescription(
            image_grid="ground",
            image_center_x=float(center[0] + scene.offset[0]),
            image_center_y=float(center[1] + scene.offset[1]),
            image_height=float(center[2] + scene.offset[2]),
            image_extent_azimuth=extent,
            image_extent_range=extent,
            pixel_spacing_azimuth=spacing[0],
            pixel_spacing_range=spacing[1],
        ),
        track,
    )
    used = list_with_parts([scene.materials[i] for i in np.unique(scene.geometry.face_material)])
    radar, image, notes = seen_by(scene.name, scene.geometry, scene.places, used, description, scene.offset)
    return dataclasses.replace(scene, radar=radar, image=image, notes=notes, description=description)


def _pixel_spacings(half: float, elevation: float, shortest: float, longest: float) -> tuple[float, float]:
    r"""Pixel spacings (azimuth, range), m: ``PIXEL_FILL`` of the Nyquist spacing of the image's spectrum.

    Aspects :math:`|\phi| \le \phi_h` about the middle and wavelengths from the shortest to the longest fill

    .. math:: k_a = \pm \frac{4 \pi}{\lambda_s} \cos\epsilon \sin(\min(\phi_h, \pi / 2)), \quad
              \frac{4 \pi}{\lambda} \cos\epsilon \cos\phi_h \le k_r \le \frac{4 \pi}{\lambda_s} \cos\epsilon
    """
    unit = 2.0 * np.cos(elevation)  # cycles per metre times the wavelength
    along = 2.0 * unit / shortest * np.sin(min(half, 0.5 * np.pi))
    lowest = np.cos(min(half, np.pi))
    across = unit / shortest - unit * lowest / (longest if lowest > 0.0 else shortest)
    return float(PIXEL_FILL / along), float(PIXEL_FILL / across)
