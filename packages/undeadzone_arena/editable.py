"""Hook of hatchling: an editable installation finds the code in src, and copies none of it."""

from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Editable(BuildHookInterface):  # type: ignore[type-arg]
    """Files of an editable installation: its license alone."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Set the files of an editable installation.

        Args:
            version: of the target, standard or editable.
            build_data: of hatchling; changed in place.
        """
        if version == "editable":
            place = f"undeadzone_arena-{self.metadata.version}.dist-info"
            build_data["force_include_editable"] = {"../../LICENSE": f"{place}/licenses/LICENSE"}
