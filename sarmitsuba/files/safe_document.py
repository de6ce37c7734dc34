"""Documents of a Sentinel-1 level-1 product: annotation, calibration, noise and manifest (S1-RS-MDA-52-7441)."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from xml.etree import ElementTree as ET

import numpy as np

from sarmitsuba.core.arrays import F64, I64
from sarmitsuba.core.constants import (
    EARTH_FLATTENING,
    EARTH_GRAVITY,
    EARTH_RADIUS,
    SPEED_OF_LIGHT,
)
from sarmitsuba.files.burst_lines import BurstMap, Lattice
from sarmitsuba.radar.collection import Signal
from sarmitsuba.radar.orbit import EARTH_SPIN
from sarmitsuba.radar.radar import Burst
from sarmitsuba.radar.utc import utc_after
from sarmitsuba.version import __version__

# grid of geolocation in a burst and over range, samples between calibration values
_GRID_LINES, _GRID_SAMPLES, _STEP = 2, 21, 40
# of state vectors, s about the product
_ORBIT_STEP, _ORBIT_REACH = 1, 15
_STILL = {name: {"re": 0.0, "im": 0.0} for name in ("outputDataMean", "outputDataStdDev")}
_SAFE = "http://www.esa.int/safe/sentinel-1.0"
_NAMESPACES = {
    "xfdu": "urn:ccsds:schema:xfdu:1",
    "safe": _SAFE,
    "s1": f"{_SAFE}/sentinel-1",
    "s1sar": f"{_SAFE}/sentinel-1/sar",
    "s1sarl1": f"{_SAFE}/sentinel-1/sar/level-1",
    "gml": "http://www.opengis.net/gml",
}


Content = dict[str, object]
"""Names and values of a part of a document."""


def _grow(parent: ET.Element, content: Content) -> ET.Element:
    """Children of an element, from names and values: text, number, a dictionary, or a list of elements of one name.

    A name ``xList`` holds a list of ``x``, with its count; ``@name`` is an attribute, the empty name the text.
    """
    for name, value in content.items():
        if name.startswith("@"):
            parent.set(name[1:], _text(value))
        elif not name:
            parent.text = _text(value)
        elif isinstance(value, list):
            child = ET.SubElement(parent, name, count=str(len(value)))
            for each in value:
                _grow(ET.SubElement(child, name.removesuffix("List")), each)
        elif isinstance(value, dict):
            _grow(ET.SubElement(parent, name), value)
        elif isinstance(value, np.ndarray):
            ET.SubElement(parent, name, count=str(value.size)).text = " ".join(
                _text(v) for v in value.tolist()
            )
        else:
            ET.SubElement(parent, name).text = _text(value)
    return parent


def _text(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.15e}" if isinstance(value, float) else str(value)


def _utc(time: np.datetime64) -> str:
    """UTC to the microsecond, without the letter Z."""
    return str(np.datetime_as_string(np.datetime64(time), unit="us"))


def write(root: ET.Element) -> bytes:
    """An XML document, indented."""
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True))


@dataclass(frozen=True, eq=False)
class Product:
    """What the documents of a product say, for one polarisation.

    Parameters
    ----------
    maps : of its bursts, in the order of time; one for stripmap
    lattice : lines and samples
    scale : digital number of a beta0 of 1
    polarisation : such as ``VV``
    number : of the image in the product, from 1
    """

    maps: tuple[BurstMap, ...]
    lattice: Lattice
    scale: float
    polarisation: str
    number: int

    @cached_property
    def burst(self) -> Burst | None:
        """The first burst; None for stripmap."""
        facts = self.maps[0].image.metadata.get("burst")
        return Burst(**{**facts, "sub_swaths": tuple(facts["sub_swaths"])}) if facts else None

    @property
    def mode(self) -> str:
        """``IW``, ``EW`` by the names of the sub-swaths or their number, or ``SM``."""
        if not self.burst:
            return "SM"
        return "EW" if self.burst.sub_swath.upper().startswith("EW") else "IW"

    @property
    def swath(self) -> str:
        """``IW1`` and so on, or ``S3``."""
        if not self.burst:
            return "S3"
        return f"{self.mode}{self.burst.sub_swaths.index(self.burst.sub_swath) + 1}"

    def utc(self, time: float) -> str:
        """UTC of a time of the orbit, s."""
        return _utc(utc_after(self.maps[0].orbit.epoch, time))

    @property
    def start(self) -> float:
        """Time of the first line, s."""
        return float(self.lattice.times(self.maps[0].middle)[0])

    @property
    def stop(self) -> float:
        """Time of the last line, s."""
        return float(self.lattice.times(self.maps[-1].middle)[-1])

    @property
    def lines(self) -> int:
        """Lines of all bursts."""
        return self.lattice.lines * len(self.maps)

    @property
    def identity(self) -> str:
        """Start and stop and numbers, as in names of files."""
        times = [self.utc(t)[:19].replace("-", "").replace(":", "").lower() for t in (self.start, self.stop)]
        return f"{times[0]}-{times[1]}-000001-000001-{self.number:03d}"

    @property
    def file_stem(self) -> str:
        """Name of the files of this polarisation, without suffix."""
        return f"s1a-{self.swath.lower()}-slc-{self.polarisation.lower()}-{self.identity}"

    @cached_property
    def ascending_node(self) -> float:
        """Time of the last northward crossing of the equator, s, of a circular orbit through the middle."""
        x, v = (part[0] for part in self.maps[0].orbit.at(np.array([self.maps[0].middle])))
        v = v + np.cross(EARTH_SPIN, x)
        normal = np.cross(x, v)
        node = np.array([-normal[1], normal[0], 0.0])
        node /= np.linalg.norm(node)
        angle = np.arctan2(np.cross(node, x) @ normal / np.linalg.norm(normal), node @ x) % (2.0 * np.pi)
        return self.maps[0].middle - float(angle / np.sqrt(EARTH_GRAVITY / np.linalg.norm(x) ** 3))

    @property
    def ascending(self) -> bool:
        """Whether the satellite flies northwards."""
        return bool(self.maps[0].orbit.at(np.array([self.maps[0].middle]))[1][0, 2] > 0.0)

    def incidence(self, ranges: F64 | float) -> F64:
        """Incidence angle at slant ranges, rad."""
        image = self.maps[0].image
        place = self.maps[0].slant_range.on(
            np.array([0.5 * image.grid.shape[0]]), np.arange(image.grid.shape[1], dtype=np.float64)
        )
        return np.asarray(np.interp(ranges, place[0], image.incidence_angle))

    # documents ------------------------------------------------------------------------------------------------------

    def header(self) -> Content:
        """Header of every document."""
        return {
            "missionId": "S1A",
            "productType": "SLC",
            "polarisation": self.polarisation,
            "mode": self.mode,
            "swath": self.swath,
            "startTime": self.utc(self.start),
            "stopTime": self.utc(self.stop),
            "absoluteOrbitNumber": 1,
            "missionDataTakeId": 1,
            "imageNumber": f"{self.number:03d}",
        }

    def annotation(self) -> ET.Element:
        """Annotation of the image."""
        return _grow(
            ET.Element("product"),
            {
                "adsHeader": self.header(),
                "qualityInformation": {"productQualityIndex": 0.0, "qualityDataList": [self._quality()]},
                "generalAnnotation": self._general(),
                "imageAnnotation": self._image(),
                "dopplerCentroid": {"dcEstimateList": [self._doppler(one) for one in self.maps]},
                "antennaPattern": {"antennaPatternList": [self._pattern(one) for one in self.maps]},
                "swathTiming": self._timing(),
                "geolocationGrid": {"geolocationGridPointList": self._grid()},
                "coordinateConversion": {"coordinateConversionList": []},
                "swathMerging": {"swathMergeList": []},
            },
        )

    @property
    def _signal(self) -> Signal:
        return self.maps[0].collection.signal

    def _general(self) -> Content:
        signal, first = self._signal, self.maps[0]
        v = first.orbit.at(np.array([first.middle]))[1][0]
        heading = np.degrees(np.arctan2(*(first.image.anchor.axes @ v)[:2]))
        return {
            "productInformation": {
                "pass": "Ascending" if self.ascending else "Descending",
                "timelinessCategory": "Fast-24h",
                "platformHeading": float(heading),
                "projection": "Slant Range",
                "rangeSamplingRate": SPEED_OF_LIGHT / (2.0 * self.lattice.spacing),
                "radarFrequency": signal.center_frequency,
                "azimuthSteeringRate": float(np.degrees(self.burst.steering_rate if self.burst else 0.0)),
            },
            "downlinkInformationList": [self._downlink()],
            "orbitList": [
                {
                    "time": self.utc(time),
                    "frame": "Earth Fixed",
                    **{
                        name: dict(zip("xyz", (float(value) for value in part[0]), strict=True))
                        for name, part in zip(
                            ("position", "velocity"), first.orbit.at(np.array([time])), strict=True
                        )
                    },
                }
                for time in np.round(first.middle) + np.arange(-_ORBIT_REACH, _ORBIT_REACH + 1, _ORBIT_STEP)
            ],
            "attitudeList": [],
            "rawDataAnalysisList": [self._analysis()],
            "replicaInformationList": [self._replica()],
            "noiseList": [],
            "terrainHeightList": [
                {"azimuthTime": self.utc(one.middle), "value": self._height(one)} for one in self.maps
            ],
            "azimuthFmRateList": [
                {
                    "azimuthTime": self.utc(one.middle),
                    "t0": 2.0 / SPEED_OF_LIGHT * self.lattice.start_range,
                    "azimuthFmRatePolynomial": self._fm_rate(one),
                }
                for one in self.maps
            ],
        }

    def _downlink(self) -> Content:
        signal, lattice = self._signal, self.lattice
        prf = self.maps[0].collection.pulse_rate
        delay = 2.0 / SPEED_OF_LIGHT * lattice.start_range
        errors = (
            "SyncMarker DataTakeId EccNumber TestMode RxChannelId InstrumentConfigId PacketCount PriCount SsbErrorFlag "
            "BaqMode BaqBlockLength RangeDecimation RxGain TxRampRate TxPulseStartFrequency Rank Pri Swst Swl "
            "Polarisation TempComp ElevationBeamAddress AzimuthBeamAddress SasTestMode CalType CalibrationBeamAddress "
            "CalMode TxPulseNumber SignalType SwapFlag SwathNumber"
        ).split()
        rank = int(delay * prf)
        return {
            "swath": self.swath,
            "azimuthTime": self.utc(self.start),
            "firstLineSensingTime": self.utc(self.maps[0].collection.flight.span[0]),
            "lastLineSensingTime": self.utc(self.maps[-1].collection.flight.span[2]),
            "prf": prf,
            "bitErrorCount": {
                **{f"numErr{name}": 0 for name in errors},
                "numErrNumberOfQuads": 0,
                "numIspHeaderErrors": 0,
            },
            "downlinkValues": {
                "pri": 1.0 / prf,
                "rank": rank,
                "dataTakeId": 1,
                "eccNumber": 8,
                "rxChannelId": 0,
                "instrumentConfigId": 1,
                "dataFormat": {
                    "baqBlockLength": 256,
                    "echoFormat": "Bypass",
                    "noiseFormat": "Bypass",
                    "calibrationFormat": "Bypass",
                    "meanBitRate": 10.0,
                },
                "rangeDecimation": {
                    "decimationFilterBandwidth": signal.bandwidth,
                    "samplingFrequencyAfterDecimation": signal.sampling_rate,
                    "filterLength": 36,
                },
                "rxGain": 0.0,
                "txPulseLength": signal.pulse_width,
                "txPulseStartFrequency": -0.5 * signal.bandwidth,
                "txPulseRampRate": signal.bandwidth / signal.pulse_width,
                "swathNumber": 10,
                "swlList": [
                    {
                        "azimuthTime": self.utc(self.start),
                        "value": lattice.samples * 2 * lattice.spacing / SPEED_OF_LIGHT,
                    }
                ],
                "swstList": [{"azimuthTime": self.utc(self.start), "value": delay - rank / prf}],
                "pointingStatusList": [],
            },
        }

    def _quality(self) -> Content:
        """Quality: none of the faults of a downlink."""
        counts = (
            "DownlinkInputDataGaps downlinkGapsInInputData|DownlinkInputMissingLines downlinkMissingLines|"
            "InstrumentInputDataGaps instrumentGapsInInputData|InstrumentInputMissingLines instrumentMissingLines|"
            "SsbErrorInputDataGaps ssbErrorGapsInInputData|SsbErrorInputMissingLines ssbErrorMissingLines"
        ).split("|")
        faults: Content = {}
        for number, flag in (pair.split() for pair in counts):
            faults |= {f"num{number}": 0, f"{flag}SignificantFlag": False}
        means = {f"{part}InputDataMean": 0.0 for part in "iq"}
        deviations = {f"{part}InputDataStdDev": 0.0 for part in "iq"}
        product = (
            "meanPgProductAmplitude",
            "stdDevPgProductAmplitude",
            "meanPgProductPhase",
            "stdDevPgProductPhase",
        )
        return {
            "azimuthTime": self.utc(self.start),
            "downlinkQuality": {
                **means,
                "inputDataMeanOutsideNominalRangeFlag": False,
                **deviations,
                "inputDataStDevOutsideNominalRangeFlag": False,
                **faults,
                "chirpSourceUsed": "Nominal",
                "pgSourceUsed": "Model",
                "rrfSpectrumUsed": "Unextended",
                "replicaReconstructionFailedFlag": False,
                **dict.fromkeys(product, 0.0),
                "pgProductDerivationFailedFlag": False,
                "invalidDownlinkParamsFlag": False,
            },
            "rawDataAnalysisQuality": {
                "iBias": 0.0,
                "iBiasSignificanceFlag": False,
                "qBias": 0.0,
                "qBiasSignificanceFlag": False,
                "iqGainImbalance": 1.0,
                "iqGainSignificanceFlag": False,
                "iqQuadratureDeparture": 0.0,
                "iqQuadratureDepartureSignificanceFlag": False,
            },
            "dopplerCentroidQuality": {
                "dcMethod": "Orbit and Attitude",
                "dopplerCentroidUncertainFlag": False,
            },
            "imageQuality": {
                "imageStatistics": _STILL,
                "outputDataMeanOutsideNominalRangeFlag": False,
                "outputDataStDevOutsideNominalRangeFlag": False,
            },
        }

    def _analysis(self) -> Content:
        """Analysis of the raw data: an ideal receiver."""
        names = ("iBias", "qBias", "iqQuadratureDeparture", "iqGainImbalance")
        ideal = {name: float(name == "iqGainImbalance") for name in names}
        bounds: dict[str, float] = {}
        for name in ("iBias", "qBias", "iqGain", "iqQuadratureDeparture"):
            bounds |= {f"{name}{end}Bound": float(name == "iqGain") for end in ("Upper", "Lower")}
        used = {f"{name}UsedForCorrection": ideal[name] for name in ("iBias", "qBias", *names[:1:-1])}
        return {"azimuthTime": self.utc(self.start), **ideal, "support": {**bounds, **used}}

    def _replica(self) -> Content:
        """The nominal pulse."""
        signal, start = self._signal, self.utc(self.start)
        rate = signal.bandwidth / signal.pulse_width
        quality = ("crossCorrelationBandwidth", "crossCorrelationPslr", "crossCorrelationIslr")
        return {
            "swath": self.swath,
            "referenceReplica": {
                "azimuthTime": start,
                "chirpSource": "Nominal",
                "pgSource": "Model",
                "amplitudeCoefficients": np.array([1.0, 0.0, 0.0, 0.0]),
                "phaseCoefficients": np.array([0.0, 0.0, 0.5 * rate, 0.0]),
                "timeDelay": 0.0,
                "gain": {"re": 1.0, "im": 0.0},
            },
            "replicaList": [
                {
                    "azimuthTime": start,
                    **dict(zip(quality, (1.0, -13.3, -9.7), strict=True)),
                    "crossCorrelationPeakLocation": 0.0,
                    "reconstructedReplicaValidFlag": False,
                    **dict.fromkeys(("pgProductAmplitude", "pgProductPhase"), 0.0),
                    **dict.fromkeys(("modelPgProductAmplitude", "modelPgProductPhase"), 0.0),
                    "relativePgProductValidFlag": False,
                    "absolutePgProductValidFlag": False,
                    "internalTimeDelay": 0.0,
                }
            ],
        }

    def _pattern(self, one: BurstMap) -> Content:
        """Elevation pattern that is left in the pixels: 1, as they are divided by the antenna's gain."""
        samples = self._samples
        ranges = self.lattice.ranges[samples]
        incidence = np.degrees(self.incidence(ranges))
        return {
            "swath": self.swath,
            "azimuthTime": self.utc(one.middle),
            "slantRangeTime": 2.0 / SPEED_OF_LIGHT * ranges,
            "elevationAngle": self._look(incidence),
            "elevationPattern": np.tile([1.0, 0.0], ranges.size),
            "incidenceAngle": incidence,
            "terrainHeight": self._height(one),
            "roll": 0.0,
        }

    def _look(self, incidence: F64 | float) -> F64:
        """Angle off nadir at the satellite, deg, of incidence angles, deg, over a sphere."""
        first = self.maps[0]
        radius = float(np.linalg.norm(first.orbit.at(np.array([first.middle]))[0]))
        return np.asarray(np.degrees(np.arcsin(EARTH_RADIUS / radius * np.sin(np.radians(incidence)))))

    def _height(self, one: BurstMap) -> float:
        grid = one.image.grid
        middle = grid.positions_on_line(grid.shape[0] // 2)[grid.shape[1] // 2] + grid.offset
        return float(one.image.anchor.to_geodetic(middle)[2])

    def _fm_rate(self, one: BurstMap) -> F64:
        """k_a as a polynomial of two-way time after the first sample, lowest power first."""
        ranges = self.lattice.ranges
        tau = 2.0 / SPEED_OF_LIGHT * (ranges - ranges[0])
        scale = max(float(tau[-1]), 1e-12)
        fit = np.polynomial.polynomial.polyfit(tau / scale, one.point_rate(ranges), min(2, tau.size - 1))
        return np.asarray(np.pad(fit, (0, 3 - fit.size)) / scale ** np.arange(3))

    def _image(self) -> Content:
        lattice, image, signal = self.lattice, self.maps[0].image, self._signal
        speed = image.grid.azimuth_spacing / lattice.line_interval
        doppler = float(-self.maps[0].point_rate(lattice.ranges.mean()) * signal.aperture)
        window = {"windowType": "None", "windowCoefficient": 0.0}
        looks = {"numberOfLooks": 1, "lookOverlap": 0.0}
        return {
            "imageInformation": {
                "productFirstLineUtcTime": self.utc(self.start),
                "productLastLineUtcTime": self.utc(self.stop),
                "ascendingNodeTime": self.utc(self.ascending_node),
                "anchorTime": self.utc(self.start),
                "productComposition": "Individual",
                "sliceNumber": 0,
                "sliceList": [],
                "slantRangeTime": 2.0 / SPEED_OF_LIGHT * lattice.start_range,
                "pixelValue": "Complex",
                "outputPixels": "16 bit Signed Integer",
                "rangePixelSpacing": lattice.spacing,
                "azimuthPixelSpacing": float(speed * lattice.line_interval),
                "azimuthTimeInterval": lattice.line_interval,
                "azimuthFrequency": 1.0 / lattice.line_interval,
                "numberOfSamples": lattice.samples,
                "numberOfLines": self.lines,
                "zeroDopMinusAcqTime": 0.0,
                "incidenceAngleMidSwath": float(
                    np.degrees(self.incidence(lattice.ranges[lattice.samples // 2]))
                ),
                "imageStatistics": _STILL,
            },
            "processingInformation": {
                "rawDataAnalysisUsed": False,
                "orbitDataFileUsed": False,
                "attitudeDataFileUsed": False,
                "rxVariationCorrectionApplied": False,
                "antennaElevationPatternApplied": True,
                "antennaAzimuthPatternApplied": True,
                "antennaAzimuthElementPatternApplied": False,
                "dcMethod": "Orbit and Attitude",
                "dcInputData": "Range Compressed",
                "rangeSpreadingLossCompensationApplied": True,
                "srgrConversionApplied": False,
                "detectionPerformed": False,
                "thermalNoiseCorrectionPerformed": False,
                "rfiMitigationPerformed": "Never",
                "rfiMitigationDomain": "TimeAndFrequency",
                "chirpSource": "Nominal",
                "pgSource": "Model",
                "rrfSpectrum": "Unextended",
                "applicationLutId": f"sarmitsuba {__version__}",
                "swathProcParamsList": [
                    {
                        "swath": self.swath,
                        "rangeProcessing": {
                            **window,
                            "totalBandwidth": signal.bandwidth,
                            "processingBandwidth": signal.bandwidth,
                            "lookBandwidth": signal.bandwidth,
                            **looks,
                        },
                        "azimuthProcessing": {
                            **window,
                            "totalBandwidth": doppler,
                            "processingBandwidth": doppler,
                            "lookBandwidth": doppler,
                            **looks,
                        },
                        "processorScalingFactor": self.scale,
                    }
                ],
                "inputDimensionsList": [
                    {
                        "azimuthTime": self.utc(self.start),
                        "swath": self.swath,
                        "numberOfInputSamples": lattice.samples,
                        "numberOfInputLines": sum(one.collection.signal.pulses for one in self.maps),
                    }
                ],
                "referenceRange": 8e5,
                "ellipsoidName": "WGS84",
                "ellipsoidSemiMajorAxis": EARTH_RADIUS,
                "ellipsoidSemiMinorAxis": EARTH_RADIUS * (1.0 - EARTH_FLATTENING),
                "bistaticDelayCorrectionApplied": True,
                "topsFilterConvention": "Only Echo Lines" if self.burst else "All Lines",
                "orbitSource": "Auxiliary",
                "attitudeSource": "Auxiliary",
            },
        }

    def _doppler(self, one: BurstMap) -> Content:
        """Doppler centroid in the middle of a burst: none, by steering to zero Doppler."""
        return {
            "azimuthTime": self.utc(one.middle),
            "t0": 2.0 / SPEED_OF_LIGHT * self.lattice.start_range,
            "geometryDcPolynomial": np.zeros(3),
            "dataDcPolynomial": np.zeros(3),
            "dataDcRmsError": 0.0,
            "dataDcRmsErrorAboveThreshold": False,
            "fineDceAzimuthStartTime": self.utc(one.collection.flight.span[0]),
            "fineDceAzimuthStopTime": self.utc(one.collection.flight.span[2]),
            "fineDceList": [],
        }

    def _timing(self) -> Content:
        lattice, bursts = self.lattice, []
        if not self.burst:
            return {"linesPerBurst": 0, "samplesPerBurst": 0, "burstList": []}
        for i, one in enumerate(self.maps):
            time = lattice.times(one.middle)
            held = (
                (time >= one.nodes.time.min())
                & (time <= one.nodes.time.max())
                & (np.abs(time - one.middle) <= one.reach)
            )
            bursts.append(
                {
                    "azimuthTime": self.utc(time[0]),
                    "azimuthAnxTime": float(time[0] - self.ascending_node),
                    "sensingTime": self.utc(one.collection.flight.span[0]),
                    "byteOffset": i * lattice.lines * lattice.samples * 4,
                    "firstValidSample": np.where(held, 0, -1),
                    "lastValidSample": np.where(held, lattice.samples - 1, -1),
                    "burstId": {"@absolute": i + 1, "": i + 1},
                }
            )
        return {"linesPerBurst": lattice.lines, "samplesPerBurst": lattice.samples, "burstList": bursts}

    def grid_points(self) -> list[tuple[int, int, float, float, F64]]:
        """Line, sample, time (s), slant range (m), and latitude, longitude, height and incidence (deg, m) of places."""
        lattice, points = self.lattice, []
        samples = np.unique(np.linspace(0, lattice.samples - 1, _GRID_SAMPLES).astype(int))
        for i, one in enumerate(self.maps):
            ends = np.linspace(0, lattice.lines - 1, _GRID_LINES + 1).astype(int)
            for line in ends if i == len(self.maps) - 1 else ends[:-1]:
                time = float(lattice.times(one.middle)[line])
                for sample in samples:
                    slant = float(lattice.ranges[sample])
                    place = self._locate(one, time, slant)
                    points.append((i * lattice.lines + int(line), int(sample), time, slant, place))
        return points

    def _locate(self, one: BurstMap, time: float, slant: float) -> F64:
        """Latitude, longitude (deg), height (m) and incidence (deg) of the image plane at zero-Doppler time and range.

        On the plane, also beyond the image: Newton's steps for the point of the scene's horizontal plane.
        """
        anchor, grid = one.image.anchor, one.image.grid
        x, v = (part[0] for part in one.orbit.at(np.array([time])))
        at, motion = anchor.from_ecef(x), anchor.axes @ v
        height = grid.height + float(grid.offset[2])
        # the circle of equal range on the plane, cut by the plane square to the motion
        across = np.cross(motion, [0.0, 0.0, 1.0])
        across /= np.linalg.norm(across)
        across *= np.sign(across @ grid.across)
        level = motion * np.array([1.0, 1.0, 0.0])
        level /= np.linalg.norm(level)
        drop = height - at[2]
        ahead = -motion[2] * drop / float(motion @ level)
        side = np.sqrt(max(slant**2 - drop**2 - ahead**2, 0.0))
        point = at + ahead * level + side * across + np.array([0.0, 0.0, drop])
        latitude, longitude, over = anchor.to_geodetic(point)
        line = at - point
        up = anchor.axes @ np.array(
            [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)]
        )
        incidence = np.degrees(np.arccos(line @ up / np.linalg.norm(line)))
        return np.array([np.degrees(latitude), np.degrees(longitude), over, incidence])

    def _grid(self) -> list[Content]:
        return [
            {
                "azimuthTime": self.utc(time),
                "slantRangeTime": 2.0 / SPEED_OF_LIGHT * slant,
                "line": line,
                "pixel": sample,
                "latitude": float(place[0]),
                "longitude": float(place[1]),
                "height": float(place[2]),
                "incidenceAngle": float(place[3]),
                "elevationAngle": float(self._look(place[3])),
            }
            for line, sample, time, slant, place in self.grid_points()
        ]

    def calibration(self) -> ET.Element:
        """Calibration: digital numbers of a sigma0, beta0 and gamma0 of 1."""
        samples = self._samples
        incidence = self.incidence(self.lattice.ranges[samples])
        scales = {
            "sigmaNought": self.scale / np.sqrt(np.sin(incidence)),
            "betaNought": np.full(samples.size, self.scale),
            "gamma": self.scale / np.sqrt(np.tan(incidence)),
            "dn": np.full(samples.size, self.scale),
        }
        return _grow(
            ET.Element("calibration"),
            {
                "adsHeader": self.header(),
                "calibrationInformation": {"absoluteCalibrationConstant": 1.0},
                "calibrationVectorList": [
                    {"azimuthTime": self.utc(time), "line": line, "pixel": samples, **scales}
                    for line, time in ((0, self.start), (self.lines - 1, self.stop))
                ],
            },
        )

    def noise(self) -> ET.Element:
        """Noise: power of the digital numbers of the receiver's noise, from the image's NESZ."""
        samples = self._samples
        nesz = float(self.maps[0].image.metadata.get("focus", {}).get("nesz", 0.0))
        power = nesz * self.scale**2 / np.sin(self.incidence(self.lattice.ranges[samples]))
        return _grow(
            ET.Element("noise"),
            {
                "adsHeader": self.header(),
                "noiseRangeVectorList": [
                    {"azimuthTime": self.utc(time), "line": line, "pixel": samples, "noiseRangeLut": power}
                    for line, time in ((0, self.start), (self.lines - 1, self.stop))
                ],
                "noiseAzimuthVectorList": [
                    {
                        "swath": self.swath,
                        "firstAzimuthLine": 0,
                        "firstRangeSample": 0,
                        "lastAzimuthLine": self.lines - 1,
                        "lastRangeSample": self.lattice.samples - 1,
                        "line": np.array([0, self.lines - 1]),
                        "noiseAzimuthLut": np.ones(2),
                    }
                ],
            },
        )

    @property
    def _samples(self) -> I64:
        return np.unique(
            np.append(np.arange(0, self.lattice.samples, _STEP), self.lattice.samples - 1)
        ).astype(np.int64)


def _tag(name: str) -> str:
    prefix, _, local = name.partition(":")
    return f"{{{_NAMESPACES[prefix]}}}{local}"


def manifest(products: Sequence[Product], files: Sequence[tuple[str, str, str, bytes]]) -> ET.Element:
    """Manifest of a product.

    Parameters
    ----------
    products : of its polarisations
    files : of each: identifier, kind (``s1Level1ProductSchema`` and so on), path in the product, and content
    """
    import hashlib

    for prefix, uri in _NAMESPACES.items():
        ET.register_namespace(prefix, uri)
    one = products[0]
    root = ET.Element(
        _tag("xfdu:XFDU"), version="esa/safe/sentinel-1.0/sentinel-1/sar/level-1/slc/standard/iwsp"
    )
    package = ET.SubElement(
        ET.SubElement(root, "informationPackageMap"),
        _tag("xfdu:contentUnit"),
        unitType="SAFE Archive Information Package",
        textInfo=f"Sentinel-1 {one.mode} Level-1 SLC Product",
        dmdID="acquisitionPeriod platform generalProductInformation measurementOrbitReference measurementFrameSet",
        pdiID="processing",
    )
    for name, kind, _, _ in files:
        unit = "Measurement Data Unit" if kind == "s1Level1MeasurementSchema" else "Metadata Unit"
        content = ET.SubElement(package, _tag("xfdu:contentUnit"), unitType=unit, repID=kind)
        ET.SubElement(content, "dataObjectPointer", dataObjectID=name)
    metadata = ET.SubElement(root, "metadataSection")

    def wrap(identifier: str, category: str, content: Content) -> None:
        entry = ET.SubElement(
            metadata, "metadataObject", ID=identifier, classification="DESCRIPTION", category=category
        )
        wrapped = ET.SubElement(
            entry, "metadataWrap", mimeType="text/xml", vocabularyName="SAFE", textInfo=identifier
        )
        _plant(ET.SubElement(wrapped, "xmlData"), content)

    wrap("processing", "PDI", {"safe:processing": {"@name": "SLC Post Processing", "safe:facility": {
        "@name": "sarmitsuba", "safe:software": {"@name": "sarmitsuba", "@version": __version__}}}})  # fmt: skip
    wrap("platform", "DMD", {"safe:platform": {
        "safe:nssdcIdentifier": "0000-000A", "safe:familyName": "SENTINEL-1", "safe:number": "A",
        "safe:instrument": {
            "safe:familyName": {"@abbreviation": "SAR", "": "Synthetic Aperture Radar"},
            "safe:extension": {"s1sarl1:instrumentMode": {"s1sarl1:mode": one.mode, "s1sarl1:swath": one.swath}},
        }}})  # fmt: skip
    orbit = [{"@type": end, "": "1"} for end in ("start", "stop")]
    wrap("measurementOrbitReference", "DMD", {"safe:orbitReference": {
        "safe:orbitNumber": orbit, "safe:relativeOrbitNumber": orbit, "safe:cycleNumber": "1",
        "safe:phaseIdentifier": "1",
        "safe:extension": {"s1:orbitProperties": {
            "s1:pass": "ASCENDING" if one.ascending else "DESCENDING",
            "s1:ascendingNodeTime": one.utc(one.ascending_node)}}}})  # fmt: skip
    wrap("acquisitionPeriod", "DMD", {"safe:acquisitionPeriod": {
        "safe:startTime": one.utc(one.start), "safe:stopTime": one.utc(one.stop),
        "safe:extension": {"s1:timeANX": {
            "s1:startTimeANX": f"{1e3 * (one.start - one.ascending_node):.6e}",
            "s1:stopTimeANX": f"{1e3 * (one.stop - one.ascending_node):.6e}"}}}})  # fmt: skip
    points = one.grid_points()
    lines = sorted({point[0] for point in points})
    row = {line: [point[4] for point in points if point[0] == line] for line in (lines[0], lines[-1])}
    corners = [row[lines[0]][0], row[lines[0]][-1], row[lines[-1]][-1], row[lines[-1]][0]]
    wrap("measurementFrameSet", "DMD", {"safe:frameSet": {"safe:frame": {"safe:footPrint": {
        "@srsName": "http://www.opengis.net/gml/srs/epsg.xml#4326",
        "gml:coordinates": " ".join(f"{c[0]:.6f},{c[1]:.6f}" for c in corners)}}}})  # fmt: skip
    wrap("generalProductInformation", "DMD", {"s1sarl1:standAloneProductInformation": {
        "s1sarl1:instrumentConfigurationID": "1", "s1sarl1:missionDataTakeID": "1",
        "s1sarl1:transmitterReceiverPolarisation": [product.polarisation for product in products],
        "s1sarl1:productClass": "S", "s1sarl1:productClassDescription": "SAR Standard L1 Product",
        "s1sarl1:productComposition": "Individual", "s1sarl1:productType": "SLC",
        "s1sarl1:productTimelinessCategory": "Fast-24h", "s1sarl1:sliceProductFlag": "false"}})  # fmt: skip
    objects = ET.SubElement(root, "dataObjectSection")
    for name, kind, path, stored in files:
        entry = ET.SubElement(objects, "dataObject", ID=name, repID=kind)
        mime = "application/octet-stream" if path.endswith(".tiff") else "text/xml"
        stream = ET.SubElement(entry, "byteStream", mimeType=mime, size=str(len(stored)))
        ET.SubElement(stream, "fileLocation", locatorType="URL", href=f"./{path}")
        checksum = ET.SubElement(stream, "checksum", checksumName="MD5")
        checksum.text = hashlib.md5(stored, usedforsecurity=False).hexdigest()
    return root


def _plant(parent: ET.Element, content: Content) -> None:
    """Namespaced children: text, dictionaries, lists of either; ``@name`` is an attribute, the empty name the text."""
    for name, value in content.items():
        if name.startswith("@"):
            parent.set(name[1:], str(value))
        elif not name:
            parent.text = str(value)
        else:
            for each in value if isinstance(value, list) else [value]:
                child = ET.SubElement(parent, _tag(name))
                if isinstance(each, dict):
                    _plant(child, each)
                else:
                    child.text = str(each)
