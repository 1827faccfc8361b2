// The 3-D view: draws the animal, picks places on its surface, and moves parts with a gizmo.
// Needs THREE and Animal. Every body is a group at its centre of mass, in metres, with z up.
"use strict";
const View = (() => {
  const canvas = document.getElementById("canvas");
  // Without a graphics card the processor draws. Its antialiasing takes half of the time, so a
  // picture at rest is drawn larger in its place.
  function isDrawnBySoftware() {
    const gl = document.createElement("canvas").getContext("webgl2"), info = gl?.getExtension("WEBGL_debug_renderer_info");
    const name = info ? gl.getParameter(info.UNMASKED_RENDERER_WEBGL) : "";
    gl?.getExtension("WEBGL_lose_context")?.loseContext();
    return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
  }
  const bySoftware = isDrawnBySoftware();
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: !bySoftware });
  } catch (error) {
    return null;
  }
  renderer.outputColorSpace = THREE.SRGBColorSpace;
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const scene = new THREE.Scene();
  const camera = new THREE.PerspectiveCamera(32, 1, 0.001, 1000);
  camera.up.set(0, 0, 1);
  scene.add(new THREE.HemisphereLight(0xffffff, 0x8a8272, 2.0));
  const sun = new THREE.DirectionalLight(0xfff4e2, 2.2);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  sun.shadow.normalBias = 0.01;
  scene.add(sun, sun.target);
  const animal = new THREE.Group(), world = new THREE.Group(), marks = new THREE.Group(), swim = new THREE.Group();
  scene.add(animal, world, marks, swim);
  const orbit = new THREE.OrbitControls(camera, canvas);
  orbit.enableDamping = false;
  const gizmo = new THREE.TransformControls(camera, canvas);
  gizmo.setSize(0.8);
  scene.add(gizmo.getHelper());
  const proxy = new THREE.Group();
  scene.add(proxy);

  const events = { pick: () => {}, moved: () => {}, section: () => {} };
  const arrays = new Map(), shapes = new Map(), bodies = new Map();
  let drawn = null, selected = null, mode = "translate", size = 0, dirty = true, motion = null;
  let grabbed = null, armed = false;
  // Number of the chosen section of a loft, and the drawn rings and dots of all its sections.
  let section = null, rings = [];
  // Skins over chains. They are hidden while a body is chosen, so that the body is seen.
  let skins = [];

  // ---- geometry
  const array = (key, kind) => Animal.decoded(arrays.get(key), kind);
  function geometry(mesh) {
    const key = mesh.points + mesh.normals + mesh.triangles + mesh.colors;
    if (!shapes.has(key)) shapes.set(key, Animal.geometry(mesh, array));
    return shapes.get(key);
  }
  // The same shape with about a sixth of its triangles, for motions on slow machines: vertices with
  // nearly the same place and normal become one.
  function coarse(made) {
    if (made.userData.coarse || !made.index) return made.userData.coarse || made;
    const places = made.attributes.position.array, normals = made.attributes.normal.array, index = made.index.array;
    made.computeBoundingBox();
    const low = made.boundingBox.min.toArray(), size = made.boundingBox.getSize(new THREE.Vector3()).toArray();
    const kept = new Map(), same = [];
    for (let i = 0; i < places.length / 3; i++) {
      const cell = [0, 1, 2].map((k) => [Math.round(normals[3 * i + k] / 42), Math.round((4 * (places[3 * i + k] - low[k])) / (size[k] || 1))]).join();
      if (!kept.has(cell)) kept.set(cell, i);
      same.push(kept.get(cell));
    }
    const faces = [];
    for (let i = 0; i < index.length; i += 3) {
      const [a, b, c] = [same[index[i]], same[index[i + 1]], same[index[i + 2]]];
      if (a !== b && b !== c && c !== a) faces.push(a, b, c);
    }
    const found = new THREE.BufferGeometry();
    for (const [name, each] of Object.entries(made.attributes)) found.setAttribute(name, each);
    found.setIndex(faces);
    made.userData.coarse = found;
    return found;
  }
  const vector = (xyz) => new THREE.Vector3(...xyz);
  function clear(group) {
    for (const child of [...group.children]) {
      group.remove(child);
      child.traverse((each) => {
        if (each.geometry && !each.userData.shared) each.geometry.dispose();
        if (each.material) each.material.dispose();
      });
    }
  }

  // ---- the animal
  function show(state) {
    if (!state.scene) return;
    for (const [key, text] of Object.entries(state.scene.arrays)) arrays.set(key, text);
    drawn = state.scene;
    stop();
    clear(animal);
    bodies.clear();
    for (const body of drawn.bodies) {
      const group = new THREE.Group();
      group.position.copy(vector(body.place));
      group.quaternion.set(...body.turn);
      const material = Animal.material(body.mesh || { color: "#ffffff" });
      const mesh = new THREE.Mesh(body.mesh ? geometry(body.mesh) : new THREE.BufferGeometry(), material);
      mesh.userData = { shared: true, name: body.name };
      mesh.castShadow = mesh.receiveShadow = true;
      group.add(mesh);
      body.eyes.forEach((eye) => group.add(Animal.solid(eye, array)));
      animal.add(group);
      bodies.set(body.name, { ...body, group, mesh, shape: mesh.geometry });
    }
    skins = Animal.skins(drawn.skins, [...bodies.values()].map((body) => body.group), drawn.rest, array);
    skins.forEach((skin) => animal.add(skin));
    if (!size || drawn.length > 2 * size || drawn.length < 0.5 * size) {
      size = drawn.length;
      look("corner");
    }
    const reach = 1.5 * drawn.length;
    Object.assign(sun.shadow.camera, { left: -reach, right: reach, top: reach, bottom: -reach, near: 0.01, far: 8 * reach });
    sun.shadow.camera.updateProjectionMatrix();
    sun.position.set(1.2 * reach, -1.6 * reach, 3 * reach);
    surround(state.data);
    select(selected && bodies.has(selected) ? selected : null);
  }

  // ---- the world: ground, water and light. The ground is below the animal at rest.
  let raised = 0, goal = null, trail = null;
  function surround(data) {
    clear(world);
    goal = null;
    const given = data.world || {}, water = given.water === undefined ? {} : given.water;
    const wide = 12 * drawn.length;
    raised = given.ground ? drawn.lowest : 0;
    const paper = dark.matches ? "#1d2730" : "#e9eef0";
    scene.background = new THREE.Color(water ? (dark.matches ? "#12303d" : "#cfe4ea") : paper);
    const step = 10 ** Math.floor(Math.log10(drawn.length)), cells = Math.ceil(wide / step / 2) * 2;
    const lines = new THREE.GridHelper(cells * step, cells, "#7d8a90", dark.matches ? "#34444d" : "#b9c5c8");
    lines.rotation.x = Math.PI / 2;
    lines.position.z = given.ground ? 1e-4 * drawn.length : drawn.lowest - 0.15 * drawn.length;
    world.add(lines);
    // The animal faces +x.
    const head = [[0.6, 0, 0], [1.1, 0, 0], [1, 0.05, 0], [1.1, 0, 0], [1, -0.05, 0]].map((at) => vector(at).multiplyScalar(drawn.length));
    const ahead = new THREE.Line(new THREE.BufferGeometry().setFromPoints(head), new THREE.LineBasicMaterial({ color: "#e0342b" }));
    ahead.position.z = lines.position.z;
    world.add(ahead);
    if (given.ground) {
      const ground = new THREE.Mesh(new THREE.PlaneGeometry(cells * step, cells * step), new THREE.MeshStandardMaterial({ color: dark.matches ? "#57503f" : "#d9cfb6", roughness: 1 }));
      ground.receiveShadow = true;
      world.add(ground);
    }
    if (water && typeof water.surface === "number") {
      const sheet = new THREE.Mesh(new THREE.PlaneGeometry(wide, wide), new THREE.MeshBasicMaterial({ color: "#3d9fc4", transparent: true, opacity: 0.28, side: THREE.DoubleSide, depthWrite: false }));
      sheet.position.z = water.surface;
      world.add(sheet);
    }
    const task = data.task || {};
    if (!task.type || task.type === "reach_light") {
      const light = { distance: 8, bearing_deg: 30, elevation_deg: 0, ...(task.light || {}) };
      const [turn, rise] = [light.bearing_deg, light.elevation_deg].map((angle) => (angle * Math.PI) / 180);
      const at = light.at ? vector(light.at) : new THREE.Vector3(Math.cos(rise) * Math.cos(turn), Math.cos(rise) * Math.sin(turn), Math.sin(rise)).multiplyScalar(light.distance);
      if (!light.at) at.z -= raised;
      goal = lamp(at, new THREE.Vector3(0, 0, -raised));
      world.add(goal);
    }
    world.position.z = motion ? 0 : raised;
    dirty = true;
  }
  // A light, with a beam from the place where the animal starts.
  function lamp(at, from) {
    const made = new THREE.Group(), far = at.distanceTo(from);
    const ball = new THREE.Mesh(new THREE.SphereGeometry(0.06 * Math.max(drawn.length, 0.3 * far), 20, 14), new THREE.MeshBasicMaterial({ color: "#ffd45e" }));
    ball.position.copy(at);
    const beam = new THREE.BufferGeometry().setFromPoints([from.clone().lerp(at, Math.min(0.9, (0.8 * drawn.length) / far)), at]);
    made.add(ball, new THREE.Line(beam, new THREE.LineBasicMaterial({ color: "#e0a400", transparent: true, opacity: 0.5 })));
    return made;
  }

  // ---- selection: the part, its copies, its joint and its eyes
  function select(name) {
    if (name !== selected) section = null;
    selected = name;
    const chosen = bodies.get(name);
    for (const body of bodies.values()) {
      const alike = chosen && chosen.entry && body.entry === chosen.entry;
      body.mesh.material.emissive.set(body === chosen ? "#7a3410" : alike ? "#3a1a08" : "#000000");
    }
    skins.forEach((skin) => (skin.visible = !chosen || Boolean(motion)));
    clear(marks);
    gizmo.detach();
    if (chosen && !motion) {
      for (const body of bodies.values()) {
        if (body === chosen || (chosen.entry && body.entry === chosen.entry)) drawBox(body, body === chosen);
      }
      if (chosen.joint) drawJoint(chosen);
      drawViews(chosen);
      drawPressure(chosen);
      drawSections(chosen);
      attach(chosen);
    }
    dirty = true;
  }
  // Edges around the chosen part and its copies, which have any color.
  function drawBox(body, whole) {
    if (!Math.max(...body.half)) return;
    const points = [], [x, y, z] = body.half.map((half) => 1.05 * half);
    for (const one of [-1, 1]) {
      for (const two of [-1, 1]) {
        for (const three of [-1, 1]) points.push([three * x, one * y, two * z], [one * x, three * y, two * z], [one * x, two * y, three * z]);
      }
    }
    // Each edge has its two ends three places apart.
    const ends = points.flatMap((at, i) => (i % 6 < 3 ? [at, points[i + 3]] : [])).map(vector);
    const frame = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(ends), new THREE.LineBasicMaterial({ color: dark.matches ? "#ffd9c2" : "#7a3410", transparent: true, opacity: whole ? 1 : 0.4 }));
    frame.position.copy(body.group.position);
    frame.quaternion.copy(body.group.quaternion);
    marks.add(frame);
  }
  const AXES = ["#e0342b", "#27963c", "#2f6fe0", "#b04fd0", "#c08a00", "#109a9a"];
  function drawJoint(body) {
    const anchor = vector(body.joint.place), radius = 1.25 * Math.max(...body.half) || 0.1 * drawn.length;
    const dot = new THREE.Mesh(new THREE.SphereGeometry(0.06 * radius, 16, 12), new THREE.MeshBasicMaterial({ color: "#ffffff", depthTest: false }));
    dot.position.copy(anchor);
    marks.add(dot);
    body.joint.axes.forEach((axis, i) => {
      const place = vector(axis.at), out = vector(body.place).sub(place);
      const along = vector(axis.along), pen = new THREE.LineBasicMaterial({ color: AXES[i], depthTest: false });
      const half = along.clone().multiplyScalar(0.6 * radius);
      marks.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints([place.clone().sub(half), place.clone().add(half)]), pen));
      if (axis.kind === "slide") {
        // The range of a slide is a line with two dots.
        for (const end of axis.lower === null ? [] : [axis.lower, axis.upper]) {
          const stop = new THREE.Mesh(new THREE.SphereGeometry(0.04 * radius, 12, 8), new THREE.MeshBasicMaterial({ color: AXES[i], depthTest: false }));
          stop.position.copy(place).addScaledVector(along, end);
          marks.add(stop);
        }
        return;
      }
      // The limits are an arc from the neutral direction of the part.
      let start = out.clone().addScaledVector(along, -out.dot(along));
      if (start.length() < 0.1 * out.length()) start = new THREE.Vector3(along.y, along.z, along.x).cross(along);
      start.setLength(radius * (1 - 0.12 * i));
      const [low, high] = axis.lower === null ? [-180, 180] : [axis.lower, axis.upper];
      const points = [];
      if (axis.lower !== null) points.push(place.clone());
      for (let k = 0; k <= 48; k++) {
        const angle = ((low + ((high - low) * k) / 48) * Math.PI) / 180;
        points.push(place.clone().add(start.clone().applyAxisAngle(along, angle)));
      }
      if (axis.lower !== null) points.push(place.clone());
      marks.add(new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), pen));
    });
    marks.children.forEach((each) => (each.renderOrder = 5));
  }
  function drawViews(body) {
    for (const eye of drawn.sights) {
      if (eye.body !== body.name) continue;
      const reach = 0.3 * drawn.length, along = vector(eye.along), from = vector(eye.place);
      const sideways = (Math.abs(along.z) < 0.9 ? new THREE.Vector3(0, 0, 1) : new THREE.Vector3(1, 0, 0)).cross(along).normalize();
      const points = [];
      for (let k = 0; k < 48; k++) {
        // Rays on the rim of the field of view, and its circle.
        for (const turn of [k, k + 1]) {
          const ray = along.clone().applyAxisAngle(sideways, Math.min(eye.half_angle, Math.PI)).applyAxisAngle(along, (turn * Math.PI) / 24);
          points.push(from.clone().addScaledVector(ray, reach));
        }
        if (k % 6 === 0) points.push(from.clone(), points[points.length - 2].clone());
      }
      const cone = new THREE.LineSegments(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color: "#e0a400", transparent: true, opacity: 0.7 }));
      const frame = new THREE.Group();
      frame.position.copy(body.group.position);
      frame.quaternion.copy(body.group.quaternion);
      frame.add(cone);
      marks.add(frame);
    }
  }

  // A pad on each side of a body with a pressure sensor, which feels the whole body.
  function drawPressure(body) {
    if (!drawn.pressure.includes(body.whole || body.name) || !body.mesh.geometry.index) return;
    const far = 4 * Math.max(...body.half), radius = 0.25 * Math.min(...body.half);
    body.group.updateMatrixWorld();
    for (const side of [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]) {
      const out = vector(side).applyQuaternion(body.group.quaternion);
      ray.set(body.group.position.clone().addScaledVector(out, far), out.clone().negate());
      const [first] = ray.intersectObject(body.mesh, false);
      if (!first) continue;
      const normal = first.face.normal.clone().applyQuaternion(body.group.quaternion);
      const pad = new THREE.Mesh(new THREE.SphereGeometry(radius, 20, 12), new THREE.MeshStandardMaterial({ color: "#2f6fe0", roughness: 0.4 }));
      pad.scale.z = 0.2;
      pad.position.copy(first.point);
      pad.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), normal);
      marks.add(pad);
    }
  }

  // ---- sections of a loft: a ring and a dot for each
  function drawSections(body) {
    rings = [];
    if (section !== null && !body.sections?.[section]) section = null;
    const size = 0.035 * Math.max(...body.half);
    (body.sections || []).forEach((each, i) => {
      const color = i === section ? "#ffb000" : "#ffffff", group = new THREE.Group(), points = [];
      for (const [y, z] of [...each.outline, each.outline[0]]) {
        points.push(vector(each.across).multiplyScalar(y).addScaledVector(vector(each.up), z));
      }
      const ring = new THREE.Line(new THREE.BufferGeometry().setFromPoints(points), new THREE.LineBasicMaterial({ color, depthTest: false }));
      const dot = new THREE.Mesh(new THREE.SphereGeometry(size, 14, 10), new THREE.MeshBasicMaterial({ color, depthTest: false }));
      dot.userData.section = i;
      ring.renderOrder = dot.renderOrder = 6;
      group.add(ring, dot);
      group.position.copy(vector(each.place)).applyQuaternion(body.group.quaternion).add(body.group.position);
      group.quaternion.copy(body.group.quaternion);
      marks.add(group);
      rings.push(group);
    });
  }
  function attachSection(body) {
    const { across, up } = body.sections[section], [y, z] = [vector(across), vector(up)];
    if (mode === "rotate") return;
    // An edge or a tip has no direction of its own.
    if (y.lengthSq() < 1e-20) y.set(0, 1, 0);
    if (z.lengthSq() < 1e-20 || Math.abs(z.clone().normalize().dot(y.clone().normalize())) > 0.9) z.set(0, 0, 1);
    const turn = new THREE.Matrix4().makeBasis(y.clone().cross(z).normalize(), y.normalize(), z.normalize());
    proxy.position.copy(rings[section].position);
    proxy.quaternion.copy(body.group.quaternion).multiply(new THREE.Quaternion().setFromRotationMatrix(turn));
    proxy.scale.set(1, 1, 1);
    proxy.updateMatrixWorld();
    gizmo.showX = mode !== "scale";
    gizmo.setMode(mode);
    gizmo.setSpace(mode === "translate" ? "world" : "local");
    gizmo.attach(proxy);
  }

  // ---- gizmo: the proxy is at the joint, or at the centre for a stretch
  function attach(body) {
    gizmo.showX = true;
    if (!armed && section !== null && body.sections?.[section]) return attachSection(body);
    if (armed || (!body.joint && mode !== "scale")) return;
    proxy.position.copy(vector(mode === "scale" ? body.place : body.joint.place));
    proxy.quaternion.set(...body.turn);
    proxy.scale.set(1, 1, 1);
    proxy.updateMatrixWorld();
    gizmo.setMode(mode);
    gizmo.setSpace(mode === "translate" ? "world" : "local");
    gizmo.attach(proxy);
  }
  function limb(name) {
    const found = [name];
    for (const each of found) {
      for (const body of bodies.values()) if (body.parent === each) found.push(body.name);
    }
    return found;
  }
  gizmo.addEventListener("change", () => (dirty = true));
  gizmo.addEventListener("dragging-changed", (event) => {
    orbit.enabled = !event.value;
    const body = bodies.get(selected);
    if (!body) return;
    if (event.value) {
      grabbed = { from: proxy.position.clone(), start: proxy.matrixWorld.clone(), limb: limb(selected).map((name) => bodies.get(name)) };
      for (const each of grabbed.limb) each.held = each.group.matrix.clone();
      return;
    }
    if (!grabbed) return;
    const { from } = grabbed;
    grabbed = null;
    if (section !== null) {
      if (mode === "translate") events.moved("move_section", { part: selected, index: section, by: proxy.position.clone().sub(from).toArray() });
      else events.moved("scale_section", { part: selected, index: section, factors: [proxy.scale.y, proxy.scale.z] });
      return;
    }
    const place = vector(mode === "scale" ? body.place : body.joint.place);
    if (mode === "translate") events.moved("shift", { part: selected, by: proxy.position.clone().sub(place).toArray() });
    if (mode === "scale") events.moved("stretch", { name: selected, factors: proxy.scale.toArray().map((x) => Math.max(Math.abs(x), 0.02)) });
    if (mode === "rotate") {
      const e = new THREE.Matrix4().makeRotationFromQuaternion(proxy.quaternion).elements;
      events.moved("turn", { part: selected, rotation: [0, 1, 2].map((i) => [e[i], e[i + 4], e[i + 8]]) });
    }
  });
  gizmo.addEventListener("objectChange", () => {
    if (!grabbed) return;
    proxy.updateMatrixWorld();
    if (section !== null) {
      rings[section].position.copy(proxy.position);
      rings[section].scale.setScalar(Math.max(proxy.scale.y, proxy.scale.z));
    } else if (mode === "scale") {
      bodies.get(selected).mesh.scale.copy(proxy.scale);
    } else {
      const change = proxy.matrixWorld.clone().multiply(grabbed.start.clone().invert());
      for (const each of grabbed.limb) {
        change.clone().multiply(each.held).decompose(each.group.position, each.group.quaternion, each.group.scale);
      }
    }
    dirty = true;
  });

  // ---- picking
  const ray = new THREE.Raycaster();
  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => (pressed = [event.clientX, event.clientY]));
  canvas.addEventListener("pointerup", (event) => {
    if (!pressed || gizmo.dragging || gizmo.axis || motion) return;
    const dragged = Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > 4;
    pressed = null;
    if (dragged) return;
    const dot = armed ? null : sectionAt(event.clientX, event.clientY);
    if (dot !== null) return events.section(dot);
    const found = hit(event.clientX, event.clientY);
    events.pick(found);
  });
  function aim(x, y) {
    const box = canvas.getBoundingClientRect();
    ray.setFromCamera(new THREE.Vector2((2 * (x - box.left)) / box.width - 1, 1 - (2 * (y - box.top)) / box.height), camera);
  }
  function sectionAt(x, y) {
    if (motion || !rings.length || !bodies.get(selected)?.sections?.length) return null;
    aim(x, y);
    for (const ring of rings) ring.updateMatrixWorld();
    const [first] = ray.intersectObjects(rings.map((ring) => ring.children[1]), false);
    return first ? first.object.userData.section : null;
  }
  function hit(x, y) {
    aim(x, y);
    const [first] = ray.intersectObjects([...bodies.values()].map((body) => body.mesh), false);
    if (!first) return null;
    const body = bodies.get(first.object.userData.name);
    const place = body.group.worldToLocal(first.point.clone()), normal = first.face.normal.clone();
    // A further part of a body is in the frame of the body.
    const into = new THREE.Matrix4().set(...body.turned[0], 0, ...body.turned[1], 0, ...body.turned[2], 0, 0, 0, 0, 1);
    place.sub(vector(body.frame)).applyMatrix4(into);
    normal.applyMatrix4(into);
    return { name: body.whole || body.name, entry: body.entry, place: place.toArray(), normal: normal.toArray() };
  }

  // ---- camera
  // From above, with the way from left to right or back. The side is that of the view "Side".
  function across(way) {
    const level = Math.hypot(way.x, way.y) || 1, side = way.x < 0 ? -1 : 1;
    return [(side * way.y) / level, (-side * way.x) / level || -0.01, 0.8];
  }
  function look(view, at = null) {
    fit();
    const centre = new THREE.Vector3();
    for (const body of bodies.values()) centre.addScaledVector(body.group.position, 1 / bodies.size);
    const seen = [...bodies.values()].map((body) => [body.group.position, Math.max(...body.half)]);
    const from = at ? across(at.clone().sub(centre)) : { corner: [0.55, -0.75, 0.45], side: [0, -1, 0.02], top: [0, -0.001, 1], front: [1, 0, 0.02], back: [-1, 0, 0.02] }[view];
    const out = vector(from).normalize(), right = camera.up.clone().cross(out).normalize(), up = out.clone().cross(right);
    // The distance at which every body is inside the picture, with a margin.
    const tall = Math.tan((camera.fov * Math.PI) / 360), wide = tall * camera.aspect;
    let far = 0.8 * drawn.length;
    if (at) {
      centre.lerp(at, 0.5);
      seen.push([at, 0.3 * drawn.length]);
    }
    for (const [place, reach] of seen) {
      const from = place.clone().sub(centre);
      const [x, y] = [right, up].map((axis) => Math.abs(from.dot(axis)) + reach);
      far = Math.max(far, 1.15 * Math.max(x / wide, y / tall) + from.dot(out) + reach);
    }
    orbit.target.copy(centre);
    camera.position.copy(centre).addScaledVector(out, far);
    camera.near = 0.01 * drawn.length;
    camera.far = Math.max(80 * drawn.length, 60);
    camera.updateProjectionMatrix();
    orbit.update();
    // Places are picked before the next frame, too.
    camera.updateMatrixWorld();
    dirty = true;
  }

  // ---- motion
  function play(given) {
    const place = Animal.decoded(given.place, "f4"), turn = Animal.decoded(given.turn, "i2");
    motion = { ...given, from: motion ? motion.from : [camera.position.clone(), orbit.target.clone()], places: place, turns: turn, time: 0, going: true, last: null, duration: (given.count - 1) / given.rate };
    // A burst of other work may have slowed the last motion.
    level = bySoftware ? 1 : 0;
    gaps = [];
    select(selected);
    world.position.z = 0;
    clear(swim);
    trail = null;
    if (goal) goal.visible = !given.light;
    seek(0);
    if (!given.light) return;
    // The camera stands still and the animal leaves a trail, so that its way to the light is seen.
    const centres = Array.from({ length: given.count }, (_, i) => middle(i));
    trail = new THREE.Line(new THREE.BufferGeometry().setFromPoints(centres), new THREE.LineBasicMaterial({ color: "#d6249f" }));
    swim.add(lamp(vector(given.light), centres[0]), trail);
    look("light", vector(given.light));
    seek(0);
  }
  function stop() {
    if (!motion) return;
    const [place, target] = motion.from;
    motion = null;
    clear(swim);
    trail = null;
    if (goal) goal.visible = true;
    world.position.z = raised;
    for (const body of bodies.values()) {
      body.group.position.copy(vector(body.place));
      body.group.quaternion.set(...body.turn);
    }
    camera.position.copy(place);
    orbit.target.copy(target);
    orbit.update();
    select(selected);
  }
  // Mean place of all bodies in a frame.
  function middle(i) {
    const found = new THREE.Vector3(), count = motion.names.length, p = motion.places;
    for (let k = count * i; k < count * (i + 1); k++) found.add(new THREE.Vector3(p[3 * k], p[3 * k + 1], p[3 * k + 2]));
    return found.divideScalar(count);
  }
  const one = new THREE.Quaternion(), two = new THREE.Quaternion();
  function seek(time) {
    motion.time = Math.min(Math.max(time, 0), motion.duration);
    const at = motion.time * motion.rate, i = Math.min(Math.floor(at), motion.count - 2), f = at - i;
    const count = motion.names.length, centre = middle(i).lerp(middle(i + 1), f);
    motion.names.forEach((name, k) => {
      const body = bodies.get(name);
      if (!body) return;
      const a = 3 * (i * count + k), b = a + 3 * count, p = motion.places;
      body.group.position.set(p[a] + f * (p[b] - p[a]), p[a + 1] + f * (p[b + 1] - p[a + 1]), p[a + 2] + f * (p[b + 2] - p[a + 2]));
      const c = 4 * (i * count + k), d = c + 4 * count, q = motion.turns;
      one.set(q[c], q[c + 1], q[c + 2], q[c + 3]).normalize();
      two.set(q[d], q[d + 1], q[d + 2], q[d + 3]).normalize();
      body.group.quaternion.copy(one.slerp(two, f));
    });
    trail?.geometry.setDrawRange(0, i + 2);
    if (!motion.light) {
      const step = centre.sub(orbit.target);
      orbit.target.add(step);
      camera.position.add(step);
      orbit.update();
    }
    dirty = true;
  }

  // ---- quality of a motion: if frames are slow, as without a graphics card, it draws less. A
  // picture at rest has all.
  const REST = { pixels: bySoftware ? 1.5 : 1, shadows: true, fine: true };
  const LEVELS = [
    { pixels: 1, shadows: true, fine: true }, { pixels: 1, shadows: false, fine: false },
    { pixels: 0.6, shadows: false, fine: false }, { pixels: 0.4, shadows: false, fine: false },
  ];
  const quality = () => (motion?.going ? LEVELS[level] : REST);
  // Slowest frames of a motion that looks smooth, ms, and number of frames that decide.
  const SLOW = 33, DECIDE = 12;
  let level = 0, gaps = [];
  function pace(gap) {
    gaps.push(gap);
    if (gaps.length < DECIDE) return;
    const usual = gaps.sort((a, b) => a - b)[DECIDE / 2];
    gaps = [];
    if (usual > SLOW && level < LEVELS.length - 1) level += 1;
  }
  function applyQuality() {
    const { shadows, fine } = quality();
    if (sun.castShadow !== shadows) {
      sun.castShadow = shadows;
      dirty = true;
    }
    for (const { mesh, shape } of bodies.values()) mesh.geometry = fine ? shape : coarse(shape);
  }

  // ---- loop: draws only after a change
  let frames = 0;
  function fit() {
    const wide = canvas.clientWidth, high = canvas.clientHeight;
    const ratio = Math.min(devicePixelRatio, 2) * quality().pixels;
    if (wide && high && (canvas.width !== Math.floor(wide * ratio) || canvas.height !== Math.floor(high * ratio))) {
      renderer.setPixelRatio(ratio);
      renderer.setSize(wide, high, false);
      camera.aspect = wide / high;
      // A narrow view keeps the whole animal.
      camera.fov = wide < high ? 32 * Math.min(high / wide, 1.7) : 32;
      camera.updateProjectionMatrix();
      dirty = true;
    }
  }
  function frame(now) {
    requestAnimationFrame(frame);
    fit();
    applyQuality();
    if (motion && motion.going) {
      if (motion.last !== null) pace(now - motion.last);
      if (motion.last !== null) seek(motion.time >= motion.duration ? 0 : motion.time + (now - motion.last) / 1000);
      motion.last = now;
      events.time?.(motion.time, motion.duration);
    }
    if (!dirty) return;
    dirty = false;
    frames += 1;
    renderer.render(scene, camera);
  }
  orbit.addEventListener("change", () => (dirty = true));
  dark.addEventListener("change", () => (dirty = true));
  requestAnimationFrame(frame);

  return {
    events, show, select, look, play, stop, hit,
    seek: (time) => motion && seek(time),
    pause: (paused) => { if (motion) { motion.going = !paused; motion.last = null; } },
    // While a place is asked for, no gizmo is in the way.
    arm: (asked) => { armed = asked; select(selected); },
    get section() { return section; },
    chooseSection: (index) => { section = index; select(selected); },
    dot: (index) => {
      const box = canvas.getBoundingClientRect(), at = rings[index].position.clone().project(camera);
      return [box.left + ((at.x + 1) / 2) * box.width, box.top + ((1 - at.y) / 2) * box.height];
    },
    setMode: (name) => { mode = name; select(selected); },
    screen: (name) => {
      const box = canvas.getBoundingClientRect(), at = bodies.get(name).group.position.clone().project(camera);
      return [box.left + ((at.x + 1) / 2) * box.width, box.top + ((1 - at.y) / 2) * box.height];
    },
    gizmo: (axis = "x") => {
      // A place on the arrow along an axis.
      const at = proxy.position.clone(), far = at.distanceTo(camera.position);
      at[axis] += 0.04 * far;
      const box = canvas.getBoundingClientRect();
      at.project(camera);
      return [box.left + ((at.x + 1) / 2) * box.width, box.top + ((1 - at.y) / 2) * box.height];
    },
    pose: (name) => bodies.get(name).group.position.toArray(),
    get frames() { return frames; },
    get quality() { return level; },
    get playing() { return Boolean(motion); },
    get names() { return [...bodies.keys()]; },
  };
})();
