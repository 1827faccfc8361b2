"""A binary glTF 2.0 file, put together piece by piece (Khronos Group, "glTF 2.0 Specification").

A file is one JSON document and one buffer. The buffer holds numbers, and *accessors* in the
document describe its bytes. trimesh writes such files, but without animations. It also writes
matrices instead of the translations and rotations that an animation moves.
"""

import io
import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int, UInt8
from PIL import Image

# Codes of the specification: kinds of numbers, and uses of a stretch of the buffer.
_FLOAT, _UNSIGNED, _SHORT = 5126, 5125, 5123
_VERTICES, _INDICES = 34962, 34963
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}

# Index of an added node, for references.
Node = int


class Glb:
    """A scene that grows: meshes, materials, nodes, one animation.

    Attributes:
        document: the JSON document.
    """

    def __init__(self, generator: str, title: str):
        self.document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": generator},
            "scene": 0,
            "scenes": [{"name": title, "nodes": []}],
        }
        self._buffer = bytearray()
        self._channels: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []

    def material(
        self,
        name: str,
        color: Float[np.ndarray, "3"],
        *,
        roughness: float = 0.7,
        alpha: float = 1.0,
        glow: bool = False,
        texture: int | None = None,
    ) -> int:
        """Add a material.

        Args:
            name: name of the material.
            color: red, green and blue as on a screen (sRGB), 0 to 1.
            roughness: 0 for a mirror to 1 for chalk.
            alpha: opacity.
            glow: whether the material emits light.
            texture: texture that is multiplied by the colour.
        """
        linear = _linear(color).tolist()
        surface: dict[str, Any] = {
            "baseColorFactor": [*linear, alpha],
            "metallicFactor": 0.0,
            "roughnessFactor": roughness,
        }
        if texture is not None:
            surface["baseColorTexture"] = {"index": texture}
        material: dict[str, Any] = {"name": name, "pbrMetallicRoughness": surface}
        if alpha < 1:
            material |= {"alphaMode": "BLEND", "doubleSided": True}
        if glow:
            material["emissiveFactor"] = linear
        return self._add("materials", material)

    def texture(self, image: UInt8[np.ndarray, "h w 3"]) -> int:
        """Add a picture ``(height, width, 3)`` of bytes that repeats without end."""
        png = io.BytesIO()
        Image.fromarray(image).save(png, "PNG")
        view = self._view(png.getvalue())
        source = self._add("images", {"bufferView": view, "mimeType": "image/png"})
        # Linear filter with mipmaps, repeated both ways.
        sampler = self._add(
            "samplers", {"magFilter": 9729, "minFilter": 9987, "wrapS": 10497, "wrapT": 10497}
        )
        return self._add("textures", {"source": source, "sampler": sampler})

    def mesh(
        self,
        name: str,
        points: Float[np.ndarray, "n 3"],
        normals: Float[np.ndarray, "n 3"],
        triangles: Int[np.ndarray, "m 3"],
        material: int,
        places: Float[np.ndarray, "n 2"] | None = None,
        colors: UInt8[np.ndarray, "n 3"] | None = None,
        joints: Int[np.ndarray, "n k"] | None = None,
        weights: Float[np.ndarray, "n k"] | None = None,
    ) -> int:
        """Add a mesh.

        Args:
            name: name of the mesh.
            points: corners, m.
            normals: unit normals at the corners.
            triangles: numbers of the corners, counterclockwise seen from outside.
            material: material of the whole mesh.
            places: places of the corners in the material's texture, 1 for its width and height.
            colors: colours of the corners as on a screen (sRGB), which multiply the material's.
            joints: joints of a skin that the corners follow, up to four.
            weights: weights of the joints.
        """
        attributes = {
            "POSITION": self._floats(points, _VERTICES, bounds=True),
            "NORMAL": self._floats(normals, _VERTICES),
        }
        if places is not None:
            attributes["TEXCOORD_0"] = self._floats(places, _VERTICES)
        if colors is not None:
            attributes["COLOR_0"] = self._floats(_linear(colors / 255), _VERTICES)
        if joints is not None and weights is not None:
            spare = ((0, 0), (0, 4 - joints.shape[1]))
            # A joint without weight has to be number 0.
            found = np.ascontiguousarray(np.pad(np.where(weights > 0, joints, 0), spare), "<u2")
            accessor = {
                "bufferView": self._view(found.tobytes(), _VERTICES),
                "componentType": _SHORT,
                "count": len(found),
                "type": "VEC4",
            }
            attributes["JOINTS_0"] = self._add("accessors", accessor)
            attributes["WEIGHTS_0"] = self._floats(np.pad(weights, spare), _VERTICES)
        indices = np.ascontiguousarray(triangles, "<u4").ravel()
        accessor = {
            "bufferView": self._view(indices.tobytes(), _INDICES),
            "componentType": _UNSIGNED,
            "count": len(indices),
            "type": "SCALAR",
        }
        primitive = {
            "attributes": attributes,
            "indices": self._add("accessors", accessor),
            "material": material,
        }
        return self._add("meshes", {"name": name, "primitives": [primitive]})

    def node(self, name: str, parent: Node | None = None, **properties: Any) -> Node:
        """Add a node. Without a parent it is a root of the scene.

        ``properties`` are those of the specification, such as `mesh`, `skin` and `translation`.
        """
        node = self._add("nodes", {"name": name, **properties})
        nodes = self.document["nodes"]
        brood = self.document["scenes"][0]["nodes"]
        if parent is not None:
            brood = nodes[parent].setdefault("children", [])
        brood.append(node)
        return node

    def skin(self, name: str, joints: Sequence[Node], rest: Float[np.ndarray, "j 4 4"]) -> int:
        """Add a skin, and return the value of its node's `skin`.

        Args:
            name: name of the skin.
            joints: nodes that the mesh follows.
            rest: transformations of the joints, in the scene, at which the mesh is as given.
        """
        # Columns one after another.
        inverses = np.linalg.inv(rest).swapaxes(1, 2).reshape(-1, 16)
        held = {
            "name": name,
            "joints": [*joints],
            "inverseBindMatrices": self._floats(inverses, None),
        }
        return self._add("skins", held)

    def times(self, time: Float[np.ndarray, " t"]) -> int:
        """Add the instants of an animation, s, and return their accessor for `animate`."""
        return self._floats(time[:, None], None, bounds=True)

    def animate(self, node: Node, path: str, times: int, values: np.ndarray) -> None:
        """Move a node, linearly from instant to instant (quaternions along great circles).

        ``path`` is ``translation`` (m) or ``rotation`` (quaternion x, y, z, w), with one value at
        each instant from `times`.
        """
        sampler = {"input": times, "output": self._floats(values, None), "interpolation": "LINEAR"}
        self._samplers.append(sampler)
        target = {"node": node, "path": path}
        self._channels.append({"sampler": len(self._samplers) - 1, "target": target})

    def camera(self, name: str, angle: float, aspect: float, near: float) -> int:
        """Add a camera with a vertical angle of view (rad) and the near plane's distance (m)."""
        lens = {"yfov": angle, "aspectRatio": aspect, "znear": near}
        return self._add("cameras", {"name": name, "type": "perspective", "perspective": lens})

    def light(self, name: str, kind: str, color: np.ndarray, intensity: float) -> dict[str, Any]:
        """Add a lamp (KHR_lights_punctual), and return the extensions of its node.

        The kind is ``directional`` (along the node's -z, in lux) or ``point`` (in candela). The
        colour is red, green and blue as on a screen (sRGB), 0 to 1.
        """
        extension = "KHR_lights_punctual"
        used = self.document.setdefault("extensionsUsed", [])
        if extension not in used:
            used.append(extension)
        lights = self.document.setdefault("extensions", {}).setdefault(extension, {"lights": []})
        shone = {
            "name": name,
            "type": kind,
            "color": _linear(color).tolist(),
            "intensity": intensity,
        }
        lights["lights"].append(shone)
        return {extension: {"light": len(lights["lights"]) - 1}}

    def to_bytes(self) -> bytes:
        """Return the bytes of the file."""
        document = dict(self.document)
        document["buffers"] = [{"byteLength": len(self._buffer)}]
        if self._channels:
            motion = {"name": "motion", "channels": self._channels, "samplers": self._samplers}
            document["animations"] = [motion]
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<II", len(text), _JSON_CHUNK) + text
        chunks += struct.pack("<II", len(self._buffer), _BINARY_CHUNK) + bytes(self._buffer)
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _add(self, kind: str, thing: Mapping[str, Any]) -> int:
        things = self.document.setdefault(kind, [])
        things.append(dict(thing))
        return len(things) - 1

    def _floats(self, values: np.ndarray, target: int | None, bounds: bool = False) -> int:
        """Add an accessor of rows of single-precision numbers."""
        rows = np.ascontiguousarray(values, "<f4")
        accessor: dict[str, Any] = {
            "bufferView": self._view(rows.tobytes(), target),
            "componentType": _FLOAT,
            "count": len(rows),
            "type": _KINDS[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        return self._add("accessors", accessor)

    def _view(self, data: bytes, target: int | None = None) -> int:
        """Add a stretch of the buffer, which begins at a multiple of four bytes."""
        view = {"buffer": 0, "byteOffset": len(self._buffer), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._buffer += data + bytes(-len(data) % 4)
        return self._add("bufferViews", view)


def _linear(color: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Convert red, green and blue of a screen (sRGB) to linear light, 0 to 1 (IEC 61966-2-1)."""
    color = np.asarray(color, float)
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
