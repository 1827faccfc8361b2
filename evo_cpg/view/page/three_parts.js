// Parts of three.js that `viewer.js` needs (MIT, three.LICENSE). `three.min.js` is three 0.187.0,
// bundled from this file by esbuild 0.28.2. Run these commands in a folder with this file:
//
//   npm install three@0.187.0 esbuild@0.28.2
//   npx esbuild three_parts.js --bundle --minify --format=iife --global-name=THREE
//       --legal-comments=inline --outfile=three.min.js
export {
  BackSide, BufferAttribute, BufferGeometry, CanvasTexture, Color, DirectionalLight, DoubleSide,
  Fog, Group, HemisphereLight, Line, LineBasicMaterial, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, PCFShadowMap, PerspectiveCamera, PlaneGeometry, Points, PointsMaterial,
  Quaternion, RepeatWrapping, Scene, SphereGeometry, Sprite, SpriteMaterial, SRGBColorSpace,
  Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
