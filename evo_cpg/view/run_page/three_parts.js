// Parts of three.js that `viewer.js` and the drawing page need (MIT, three.LICENSE).
// `three.min.js` is three 0.187.0, bundled from this file by esbuild 0.28.2. Run these commands in
// a folder with this file:
//
//   npm install three@0.187.0 esbuild@0.28.2
//   npx esbuild three_parts.js --bundle --minify --format=iife --global-name=THREE
//       --legal-comments=inline --outfile=three.min.js
export {
  BackSide, BufferAttribute, BufferGeometry, CanvasTexture, Color, DirectionalLight, DoubleSide,
  Fog, GridHelper, Group, HemisphereLight, InstancedMesh, Line, LineBasicMaterial, LineSegments,
  Matrix4, Mesh, MeshBasicMaterial, MeshStandardMaterial, PCFShadowMap, PerspectiveCamera,
  PlaneGeometry, Points, PointsMaterial, Quaternion, Raycaster, RepeatWrapping, Scene, Skeleton,
  SkinnedMesh, SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace, Vector2, Vector3,
  WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
export { TransformControls } from "three/examples/jsm/controls/TransformControls.js";
