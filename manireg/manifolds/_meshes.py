"""Triangle meshes -> points, normals and areas."""

import numpy as np
import trimesh


def mesh_samples(mesh) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices `(P, 3)` of a `trimesh.Trimesh` or a file, their normals and areas; what
    `PointCloud.from_mesh` documents."""
    mesh = as_mesh(mesh)
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    sound = mesh.nondegenerate_faces()
    if not np.any(sound):
        raise ValueError(f"mesh: all {len(sound)} triangles are degenerate.")
    mesh.update_faces(sound)
    mesh.remove_unreferenced_vertices()
    if not mesh.is_winding_consistent:
        raise ValueError(
            "mesh: neighbouring triangles are oriented differently, so normals change "
            "sides. Mend it with trimesh.repair.fix_winding(mesh)."
        )
    components = mesh.body_count
    if components > 1:
        raise ValueError(
            f"mesh: {components} components that do not touch; a map is smooth on one. "
            "Keep one, e.g. max(mesh.split(only_watertight=False), key=lambda m: m.area)."
        )
    corners = np.repeat(mesh.area_faces / 3, 3)
    areas = np.bincount(mesh.faces.ravel(), corners, minlength=len(mesh.vertices))
    return np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals), areas


def as_mesh(mesh) -> trimesh.Trimesh:
    """A mesh, or the file it is in."""
    if not isinstance(mesh, trimesh.Trimesh):
        try:
            mesh = trimesh.load_mesh(mesh)
        except Exception as error:  # trimesh raises many types
            raise ValueError(f"mesh: trimesh cannot load {mesh!r}: {error}.") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise ValueError(f"mesh: {mesh!r} holds no triangles.")
    if not np.all(np.isfinite(mesh.vertices)):
        raise ValueError("mesh: some vertices hold NaN or infinity; remove them.")
    return mesh
