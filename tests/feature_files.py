"""Features in the files of hloc and COLMAP, for tests that read them."""

import numpy as np


def signed(features):
    """Return the orientations in (-180, 180]."""
    return np.where(features.orientation_deg > 180, features.orientation_deg - 360, features.orientation_deg)


def hloc_parts(features, dtype=np.float32):
    """Return what hloc keeps of the features of an image."""
    parts = {"keypoints": features.xy, "scales": features.scale, "descriptors": features.descriptors.T}
    parts = {name: part.astype(dtype) for name, part in (parts | {"scores": np.zeros(len(features))}).items()}
    return parts | {"oris": signed(features), "image_size": np.array(features.image_size)}


def write_h5(path, images):
    import h5py

    with h5py.File(path, "w") as file:
        for name, parts in images.items():
            for key, value in parts.items():
                file.create_dataset(f"{name}/{key}", data=value)
    return path


def extract_colmap(path, folder):
    """Let COLMAP fill a database with its features of the images in a folder."""
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    pycolmap.extract_features(path, folder, extraction_options=options)
    return path
