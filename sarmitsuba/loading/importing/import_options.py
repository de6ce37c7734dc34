"""Options of an import: materials, heights, units, position, terrain, facade relief."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from sarmitsuba.core.errors import SceneError
from sarmitsuba.core.parameters import did_you_mean
from sarmitsuba.loading.from_mesh import UPS, Up
from sarmitsuba.loading.importing.facades import FacadeOptions
from sarmitsuba.radar.geodesy import Anchor
from sarmitsuba.scene.mesh.model_units import UNITS

# height of buildings that state neither a height nor a number of storeys: two storeys and a roof, m
HEIGHT = 8.0
STOREY = 3.0


@dataclass(frozen=True)
class ImportOptions:
    """Options of an import.

    Parameters
    ----------
    materials : name of the material by part (``walls``, ``roofs``, ``ground``, ``windows``, ``balconies``,
        ``pavement``), or by the name of a mesh file's material
    unit, up : of mesh files and of plain coordinates; the result of ``auto`` is reported
    crs : coordinate system of footprints or CityGML, such as ``EPSG:25832``; ``local``: metres, x east, y north;
        empty: as the file states, by default longitude and latitude
    anchor : geodetic position of the scene's origin; None: the centre of the imported objects
    radius : import only buildings whose centre lies within this distance of the anchor, m; 0: all
    height, storey : height of buildings that state none, and of a storey, m
    ground : whether to add a plane under the buildings; None: if neither terrain nor mesh has a ground
    dem : elevation raster of the terrain
    tolerance : largest deviation of the terrain's triangles from the raster, m
    geoid : height of the raster's zero (mean sea level) over the WGS-84 ellipsoid, m
    facades : relief of the walls, and pavement
    """

    materials: Mapping[str, str] = field(default_factory=dict)
    unit: str = "auto"
    up: Up = "auto"
    crs: str = ""
    anchor: Anchor | None = None
    radius: float = 0.0
    height: float = HEIGHT
    storey: float = STOREY
    ground: bool | None = None
    dem: Path | None = None
    tolerance: float = 0.5
    geoid: float = 0.0
    facades: FacadeOptions = field(default_factory=FacadeOptions)

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises
        ------
        SceneError : one of them is out of bounds
        """
        for name, low, high in (
            ("radius", 0.0, 1e5),
            ("height", 0.1, 2000.0),
            ("storey", 1.0, 20.0),
            ("tolerance", 1e-3, 1e3),
            ("geoid", -150.0, 150.0),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise SceneError(
                    f"import: --{name} = {value:g} m is outside {low:g} to {high:g} m; choose a value within"
                )
        if self.unit != "auto" and self.unit not in UNITS:
            guess = did_you_mean(self.unit, UNITS)
            raise SceneError(
                f'import: unit "{self.unit}" is unknown{guess}; choose one of {", ".join(UNITS)}'
            )
        if self.up not in UPS:
            raise SceneError(f'import: up axis "{self.up}" is unknown; choose one of {", ".join(UPS)}')
