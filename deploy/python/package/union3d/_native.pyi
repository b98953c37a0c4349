"""The native part: arrays in, texts of the HTTP API out. Nothing here is called by users."""

from os import PathLike

import numpy as np
from numpy.typing import NDArray

class Scene:
    described: str
    @staticmethod
    def memory(settings: str, changes_max: int) -> Scene: ...
    @staticmethod
    def directory(data: str | PathLike[str], name: str, settings: str | None) -> Scene: ...
    @staticmethod
    def server(address: str, settings: str | None, key: str | None, ca: str | PathLike[str] | None) -> Scene: ...
    def change_cubes(
        self,
        delete: NDArray[np.uint64] | None,
        ids: NDArray[np.uint64] | None,
        corners: NDArray[np.float64] | NDArray[np.int64] | None,
        number: int | None,
        duration: float | None,
        dry_run: bool,
    ) -> str: ...
    def change_solids(
        self,
        delete: NDArray[np.uint64] | None,
        ids: NDArray[np.uint64] | None,
        shapes: list[str],
        shape: NDArray[np.uint32] | None,
        start: NDArray[np.float64] | NDArray[np.int64] | None,
        end: NDArray[np.float64] | NDArray[np.int64] | None,
        hulls: list[NDArray[np.float64] | NDArray[np.int64]],
        number: int | None,
        duration: float | None,
        dry_run: bool,
    ) -> str: ...
    def define(self, name: str, shape: str) -> str: ...
    def solids(self) -> str: ...
    def revert(self, to: int) -> str: ...
    def mass_properties(self, at: int | None) -> str: ...
    def history(
        self,
        seqs: tuple[int | None, int | None],
        moves: tuple[int | None, int | None],
        limit: int | None,
    ) -> str: ...
    def audit(self) -> str: ...
    def contains(
        self, points: NDArray[np.float64] | NDArray[np.int64]
    ) -> tuple[NDArray[np.uint8], NDArray[np.bool_], NDArray[np.uint64]]: ...
    def cubes(self) -> tuple[NDArray[np.uint64], NDArray[np.int32]]: ...
    def close(self) -> None: ...
