// Surfaces of animals, for the viewer and the drawing page. Needs THREE. A function `array` returns
// an array by its name in a mesh and its kind.
"use strict";
const Animal = (() => {
  const KINDS = {
    f4: Float32Array, i2: Int16Array, i1: Int8Array, u4: Uint32Array, u2: Uint16Array,
    u1: Uint8Array,
  };
  function decoded(text, kind) {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    return new KINDS[kind](bytes.buffer);
  }
  function geometry(mesh, array) {
    const made = new THREE.BufferGeometry(), points = array(mesh.points, "f4");
    const add = (name, ...given) => made.setAttribute(name, new THREE.BufferAttribute(...given));
    add("position", points, 3);
    add("normal", array(mesh.normals, "i1"), 3, true);
    const wide = points.length > 3 * 65536;
    made.setIndex(new THREE.BufferAttribute(array(mesh.triangles, wide ? "u4" : "u2"), 1));
    if (mesh.colors !== undefined) {
      const bytes = array(mesh.colors, "u1"), colors = new Float32Array(bytes.length);
      const color = new THREE.Color();
      for (let i = 0; i < bytes.length; i += 3) {
        const [r, g, b] = [0, 1, 2].map((k) => bytes[i + k] / 255);
        color.setRGB(r, g, b, THREE.SRGBColorSpace).toArray(colors, i);
      }
      add("color", colors, 3);
    }
    return made;
  }
  function material(mesh) {
    const colors = mesh.colors !== undefined;
    const color = colors ? "#ffffff" : mesh.color;
    return new THREE.MeshStandardMaterial({ color, vertexColors: colors, roughness: 0.55 });
  }
  // Returns a mesh that casts a shadow.
  function solid(mesh, array) {
    const made = new THREE.Mesh(geometry(mesh, array), material(mesh));
    made.castShadow = made.receiveShadow = true;
    return made;
  }
  // Returns the skins over groups of bodies. `rest` holds place and turn of every body in the pose
  // in which the skins are given.
  function skins(given, groups, rest, array) {
    if (!given.length) return [];
    const one = new THREE.Vector3(1, 1, 1);
    const places = array(rest.place, "f4"), turns = array(rest.turn, "f4");
    const inverses = groups.map((_, i) => {
      const place = new THREE.Vector3().fromArray(places, 3 * i);
      const turn = new THREE.Quaternion().fromArray(turns, 4 * i);
      return new THREE.Matrix4().compose(place, turn, one).invert();
    });
    const skeleton = new THREE.Skeleton(groups, inverses);
    return given.map((skin) => {
      const made = new THREE.SkinnedMesh(geometry(skin, array), material(skin));
      const { attributes } = made.geometry;
      attributes.skinIndex = new THREE.BufferAttribute(array(skin.bodies, "u2"), 4);
      attributes.skinWeight = new THREE.BufferAttribute(array(skin.weights, "u1"), 4, true);
      made.bind(skeleton, new THREE.Matrix4());
      made.castShadow = made.receiveShadow = true;
      // Its bounds are those of the given pose.
      made.frustumCulled = false;
      return made;
    });
  }
  return { decoded, geometry, material, skins, solid };
})();
