"""Build step: wheels carry plugins/ and scenes/ inside the package; editable installs use them in place."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Hook(BuildHookInterface[Any]):
    """Adds the folders to every wheel but the editable one, which would only hold copies that go stale."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Run before the build."""
        if self.target_name == "wheel" and version == "standard":
            build_data["force_include"].update(
                {"plugins": "sarmitsuba/_plugins", "scenes": "sarmitsuba/_scenes"}
            )
