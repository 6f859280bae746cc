"""One pair of a set: two images, and what is true of them."""

from dataclasses import dataclass
from pathlib import Path

from epiprior.geometry import normalise_fundamental
from epiprior.types import FloatArray
from epiprior_lab.pairsets.cameras import Camera, Cameras, DepthMaps, fundamental_from_cameras
from epiprior_lab.pairsets.files import DatasetError, image_size, read_control_points, read_depth, read_matrix
from epiprior_lab.pairsets.homographies import normalise_homography


@dataclass(frozen=True, kw_only=True, eq=False)
class Pair:
    """Two images of one scene and their ground truth; what is None is not known or not the ground truth.

    `pair_id` is unique within the set; splits between training and test must not cross a `scene`; `difficulty` is for a
    reader, for example ``angle=21.5deg;overlap=0.79``. The matrices are text files, 3 x 3.
    """

    pair_id: str
    scene: str
    image1: Path
    image2: Path
    camera1: Camera | None
    camera2: Camera | None
    difficulty: str
    control_points_path: Path | None = None
    depth_paths: tuple[Path, Path] | None = None
    homography_path: Path | None = None
    fundamental_path: Path | None = None

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the pair that exist: images, control points, matrices, depth maps."""
        single = (self.control_points_path, self.homography_path, self.fundamental_path)
        return (self.image1, self.image2, *(path for path in single if path), *(self.depth_paths or ()))

    @property
    def truth(self) -> str:
        """``3D``: depth maps decide whether a match is right; ``plane``: a homography does; ``epipolar``: F alone.

        In the last case a match has to lie on a line, on which 1 to 4 % of random matches lie by chance.
        """
        if self.depth_paths is not None and self.camera1 is not None:
            return "3D"
        return "epipolar" if self.homography_path is None else "plane"

    def sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return (width, height) of both images, from their cameras or headers; DatasetError if a file is no image."""
        if self.camera1 is not None and self.camera2 is not None:
            return (self.camera1.width, self.camera1.height), (self.camera2.width, self.camera2.height)
        return image_size(self.image1), image_size(self.image2)

    def control_points(self) -> tuple[FloatArray, FloatArray]:
        """Return the control points, two arrays (N, 2), pixels; DatasetError without any, or if the file is damaged."""
        if self.control_points_path is None:
            raise DatasetError(f"pair {self.pair_id!r} of {self.image1.parent.parent} has no control points")
        return read_control_points(self.control_points_path)

    def fundamental(self) -> FloatArray | None:
        """Return F as given or from the cameras; None without, or with one centre; DatasetError if damaged."""
        if self.fundamental_path is not None:
            F = normalise_fundamental(read_matrix(self.fundamental_path))
            if F is None:
                raise DatasetError(f"{self.fundamental_path}: the matrix has a rank below 2")
            return F
        if self.camera1 is None or self.camera2 is None:
            return None
        return fundamental_from_cameras(self.camera1, self.camera2)

    def homography(self) -> FloatArray | None:
        """Return H of Frobenius norm 1; None where it is not the ground truth; DatasetError if damaged or singular."""
        if self.homography_path is None:
            return None
        H = normalise_homography(read_matrix(self.homography_path))
        if H is None:
            raise DatasetError(f"{self.homography_path}: the matrix is singular")
        return H

    def depths(self) -> DepthMaps | None:
        """Return both depth maps, inf where nothing is, or None; DatasetError if damaged or of wrong size."""
        if self.depth_paths is None:
            return None
        depths = []
        for path, camera in zip(self.depth_paths, (self.camera1, self.camera2), strict=True):
            depth = read_depth(path)
            if camera is not None and depth.shape != (camera.height, camera.width):
                raise DatasetError(f"{path}: depth has shape {depth.shape}, camera {camera.height, camera.width}")
            depths.append(depth)
        return depths[0], depths[1]

    def depth_views(self) -> tuple[Cameras, DepthMaps]:
        """Return both cameras and both depth maps; DatasetError where one is missing or damaged."""
        depths = self.depths()
        if depths is None or self.camera1 is None or self.camera2 is None:
            raise DatasetError(f"pair {self.pair_id!r} of {self.image1.parent.parent} has no depth maps with cameras")
        return (self.camera1, self.camera2), depths
