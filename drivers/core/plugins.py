"""Parts that installed packages provide by name."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

from drivers.core.errors import InputError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Part = TypeVar("Part")


class PluginGroup(Mapping[str, Part], Generic[Part]):
    """The parts of one entry-point group by name: first the built-in ones, then the plug-ins.

    The names are found without importing anything; a part is imported when it is taken.

    Args:
        group: Name of the group, such as "kinect_vo.cameras".
        kind: What one part is, for messages.
        built_in: Names of the parts of this package. They are known without a search.
    """

    def __init__(self, group: str, kind: str, built_in: Sequence[str]) -> None:
        self.built_in = tuple(built_in)
        self._group, self._kind = group, kind

    @property
    def plugins(self) -> tuple[str, ...]:
        """Names of the parts of other packages."""
        return tuple(sorted(self._find_entry_points().keys() - set(self.built_in)))

    def __contains__(self, name: object) -> bool:
        return name in self.built_in or name in self.plugins

    def __iter__(self) -> Iterator[str]:
        return iter((*self.built_in, *self.plugins))

    def __len__(self) -> int:
        return len(tuple(iter(self)))

    def __getitem__(self, name: str) -> Part:
        """Import a part.

        Raises:
            KeyError: No installed package has a part with this name.
            InputError: It cannot be imported.
        """
        entry_points = self._find_entry_points()
        if name not in entry_points:
            if name in self.built_in:
                raise InputError(
                    f"{self._kind} {name!r} is missing in the installation; install kinect-vo again"
                )
            raise KeyError(name)
        try:
            part: Part = entry_points[name].load()
        except Exception as error:
            raise InputError(self._describe_failure(entry_points[name], error)) from error
        return part

    def _find_entry_points(self) -> "dict[str, EntryPoint]":
        # It loads the parsers of e-mail and of ZIP files, which most commands do not need.
        from importlib.metadata import entry_points

        found = entry_points(group=self._group)
        return {entry_point.name: entry_point for entry_point in found}

    def _describe_failure(self, entry_point: "EntryPoint", error: Exception) -> str:
        package = entry_point.dist.name if entry_point.dist else entry_point.module
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return (
            f"{self._kind} {entry_point.name!r} of the package {package} cannot be imported "
            f"({reason}); install it again, or uninstall it"
        )
