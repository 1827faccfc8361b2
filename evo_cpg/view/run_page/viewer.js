// Shows animals in 3D. `Viewer.player` plays one of them, with a free camera. Needs THREE and
// Animal.
"use strict";
const Viewer = (() => {
  // Returns a function that decodes arrays of a scene at their first use.
  function decoder(texts) {
    const decoded = new Map();
    return (number, kind) => {
      const key = number + kind;
      if (!decoded.has(key)) decoded.set(key, Animal.decoded(texts[number], kind));
      return decoded.get(key);
    };
  }
  // Returns a renderer, or null without WebGL.
  function rendererOf(canvas) {
    try {
      const made = new THREE.WebGLRenderer({ canvas, antialias: true });
      made.outputColorSpace = THREE.SRGBColorSpace;
      return made;
    } catch (error) {
      return null;
    }
  }
  // Returns the motion that a scene or a list of arrays holds.
  function motionOf(data, array) {
    return {
      rate: data.rate, count: data.count, duration: (data.count - 1) / data.rate,
      position: array(data.position, "f4"), rotation: array(data.rotation, "i2"),
      focus: array(data.focus, "f4"),
      // Places of the light, one if it rests.
      lights: data.light === null ? null : array(data.light, "f4"),
    };
  }

  // ---- the world
  // Returns all things of a scene, and a function that moves them to an instant of a motion.
  function worldOf(data, anisotropy) {
    const array = decoder(data.arrays);
    const look = data.look;
    const radius = data.radius;
    const scene = new THREE.Scene();
    const horizon = new THREE.Color(look.distance);
    scene.background = horizon;
    const sight = (data.water ? 13 : 20) * radius;
    scene.fog = new THREE.Fog(horizon, (data.water ? 0.3 : 0.25) * sight, sight);
    scene.add(new THREE.HemisphereLight(look.fill, look.floor[0], data.water ? 2.6 : 1.7));
    // The colours of lines are clear in the shade, too.
    if (data.herd) scene.add(new THREE.HemisphereLight("#ffffff", "#ffffff", 0.8));
    const sun = new THREE.DirectionalLight(look.sun, data.water ? 2.6 : 2.4);
    sun.castShadow = true;
    sun.shadow.mapSize.set(2048, 2048);
    const reach = 2.2 * radius;
    Object.assign(sun.shadow.camera, {
      left: -reach, right: reach, top: reach, bottom: -reach, near: 0.1 * radius, far: 16 * radius,
    });
    sun.shadow.radius = data.water ? 6 : 3;
    sun.shadow.bias = -0.0005;
    sun.shadow.normalBias = 0.006 * radius;
    scene.add(sun, sun.target);
    const beside = data.bearing - 0.9;
    const fromSun = new THREE.Vector3(
      0.55 * Math.cos(beside), 0.55 * Math.sin(beside), data.water ? 1.6 : 1.0,
    ).normalize().multiplyScalar(6 * radius);

    // Pattern of the floor: cells of alternating brightness, and lines between them.
    function pattern() {
      const side = 512;
      const picture = document.createElement("canvas");
      picture.width = picture.height = side;
      const pen = picture.getContext("2d");
      const [dark, pale] = look.floor;
      const half = side / 2;
      for (let i = 0; i < 2; i++) {
        for (let j = 0; j < 2; j++) {
          pen.globalAlpha = 1;
          pen.fillStyle = pale;
          pen.fillRect(i * half, j * half, half, half);
          pen.globalAlpha = (i + j) % 2 ? (look.checkered ? 0.3 : 0.62) : look.checkered ? 0.12 : 0.62;
          pen.fillStyle = dark;
          pen.fillRect(i * half, j * half, half, half);
        }
      }
      pen.globalAlpha = 0.55;
      pen.fillStyle = look.grid;
      for (const at of [0, half]) {
        pen.fillRect(at - 2, 0, 4, side);
        pen.fillRect(0, at - 2, side, 4);
      }
      pen.fillRect(side - 2, 0, 4, side);
      pen.fillRect(0, side - 2, side, 4);
      const texture = new THREE.CanvasTexture(picture);
      texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
      texture.colorSpace = THREE.SRGBColorSpace;
      texture.anisotropy = anisotropy;
      return texture;
    }
    const tile = 2 * data.spacing;
    let floor = null;
    if (data.terrain) {
      // Heights at the crossings of lines, with two triangles per cell.
      const [x, y, z] = ["x", "y", "z"].map((name) => array(data.terrain[name], "f4"));
      const place = new Float32Array(3 * z.length), uv = new Float32Array(2 * z.length);
      const corners = [];
      for (let i = 0, k = 0; i < x.length; i++) {
        for (let j = 0; j < y.length; j++, k++) {
          place.set([x[i], y[j], z[k]], 3 * k);
          uv.set([x[i] / tile, y[j] / tile], 2 * k);
          if (i + 1 < x.length && j + 1 < y.length) {
            const over = k + y.length;
            corners.push(k, over, over + 1, k, over + 1, k + 1);
          }
        }
      }
      const land = new THREE.BufferGeometry();
      const normals = array(data.terrain.normals, "i1");
      land.setAttribute("position", new THREE.BufferAttribute(place, 3));
      land.setAttribute("normal", new THREE.BufferAttribute(normals, 3, true));
      land.setAttribute("uv", new THREE.BufferAttribute(uv, 2));
      land.setIndex(corners);
      const made = new THREE.Mesh(
        land, new THREE.MeshStandardMaterial({ map: pattern(), roughness: 1, side: THREE.DoubleSide }),
      );
      made.receiveShadow = true;
      scene.add(made);
    } else {
      // The floor moves with the animal by whole tiles, so its pattern stays fixed in the world.
      const tiles = 2 * Math.ceil((1.1 * sight) / tile);
      const texture = pattern();
      texture.repeat.set(tiles, tiles);
      floor = new THREE.Mesh(
        new THREE.PlaneGeometry(tiles * tile, tiles * tile),
        new THREE.MeshStandardMaterial({ map: texture, roughness: 1 }),
      );
      floor.receiveShadow = true;
      scene.add(floor);
    }
    for (const stone of data.obstacles) {
      const made = Animal.solid(stone, array);
      made.position.fromArray(stone.place);
      made.quaternion.fromArray(stone.turn);
      scene.add(made);
    }
    let sky = null;
    // Under water, the background gets lighter towards the top.
    const above = look.zenith || (data.water ? look.floor[1] : null);
    if (above) {
      const dome = new THREE.SphereGeometry(60 * radius, 24, 24);
      const place = dome.getAttribute("position");
      const colors = new Float32Array(3 * place.count);
      const zenith = new THREE.Color(above);
      const color = new THREE.Color();
      for (let i = 0; i < place.count; i++) {
        const high = Math.max(0, place.getY(i) / (60 * radius));
        color.lerpColors(horizon, zenith, Math.min(1, (data.water ? 0.9 : 2.2) * high)).toArray(colors, 3 * i);
      }
      dome.setAttribute("color", new THREE.BufferAttribute(colors, 3));
      dome.rotateX(Math.PI / 2);
      sky = new THREE.Mesh(dome, new THREE.MeshBasicMaterial({
        vertexColors: true, side: THREE.BackSide, fog: false, depthWrite: false,
      }));
      scene.add(sky);
    }
    let surface = null;
    if (data.surface !== null) {
      surface = new THREE.Mesh(
        new THREE.PlaneGeometry(2 * sight, 2 * sight),
        new THREE.MeshStandardMaterial({
          color: "#2f86a8", transparent: true, opacity: 0.42, roughness: 0.15,
          side: THREE.DoubleSide, depthWrite: false,
        }),
      );
      scene.add(surface);
    }
    function glow(color) {
      const picture = document.createElement("canvas");
      picture.width = picture.height = 128;
      const pen = picture.getContext("2d");
      const round = pen.createRadialGradient(64, 64, 0, 64, 64, 64);
      round.addColorStop(0, color);
      round.addColorStop(1, "transparent");
      pen.fillStyle = round;
      pen.fillRect(0, 0, 128, 128);
      return new THREE.CanvasTexture(picture);
    }
    const light = new THREE.Group(), arrow = new THREE.Mesh(
      new THREE.BufferGeometry(),
      new THREE.MeshBasicMaterial({ color: look.halo, fog: false, depthTest: false }),
    );
    const corners = [-0.06, -0.14, 0, 0.06, -0.14, 0, 0, 0, 0].map((x) => x * radius);
    arrow.geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
    if (data.light !== null) {
      const core = new THREE.Mesh(
        new THREE.SphereGeometry(0.09 * radius, 24, 24),
        new THREE.MeshBasicMaterial({ color: look.light, fog: false }),
      );
      const halo = new THREE.Sprite(new THREE.SpriteMaterial({
        map: glow(look.halo), transparent: true, opacity: 0.75, depthWrite: false, fog: false,
      }));
      halo.scale.setScalar(0.9 * radius);
      light.add(core, halo);
      arrow.renderOrder = 1;
      scene.add(light, arrow);
    }

    // ---- the animal
    // Each animal of a wall has its own motion.
    const herd = (data.herd || [data]).map((each, number) => {
      const bodies = each.bodies.map((body) => {
        const group = new THREE.Group();
        body.parts.forEach((part) => group.add(Animal.solid(part, array)));
        return group;
      });
      const skins = Animal.skins(each.skins, bodies, each.rest, array);
      const things = [...bodies, ...skins];
      things.forEach((thing) => { thing.userData.number = number; scene.add(thing); });
      // On an upright wall, no animal shades those below.
      const shaded = !data.herd || !data.water;
      things.forEach((thing) => thing.traverse((part) => { part.receiveShadow &&= shaded; }));
      return { bodies, skins, things, motion: data.herd && motionOf({ ...data, ...each }, array) };
    });
    const { bodies } = herd[0];
    const tiled = data.herd && !data.water;
    if (floor) floor.visible = !tiled;
    const tiles = tiled ? data.tiles.middles.map((middle, i) => {
      // The pattern moves back as the animal of the tile goes ahead.
      const map = pattern(), made = new THREE.Mesh(
        new THREE.PlaneGeometry(...data.tiles.size), new THREE.MeshStandardMaterial({ map, roughness: 1 }),
      );
      map.repeat.set(...data.tiles.size.map((side) => side / tile));
      made.position.fromArray(middle);
      made.receiveShadow = true;
      scene.add(made);
      return { map, drift: array(data.herd[i].drift, "f4") };
    }) : [];
    const own = data.herd ? { ...herd[0].motion, focus: array(data.focus, "f4") } : motionOf(data, array);
    const { position, focus } = own;

    // Path of the head. On level land it is drawn on the ground.
    const path = new Float32Array(3 * data.count);
    const low = data.floor + 0.012 * radius;
    for (let i = 0; i < data.count; i++) {
      for (let k = 0; k < 3; k++) path[3 * i + k] = position[3 * (i * bodies.length + data.head) + k];
      if (!data.water && !data.terrain && data.surface === null) path[3 * i + 2] = low;
    }
    const trail = new THREE.BufferGeometry();
    trail.setAttribute("position", new THREE.BufferAttribute(path, 3));
    const line = new THREE.Line(trail, new THREE.LineBasicMaterial({
      color: look.trail, transparent: true, opacity: 0.8,
    }));
    line.frustumCulled = false;
    if (!data.herd) scene.add(line);

    // Specks in the water show the motion. A fixed seed always gives the same specks.
    let cloud = null;
    if (look.particles && data.water) {
      let seed = 1;
      const chance = () => ((seed = (seed * 16807) % 2147483647) / 2147483647);
      const least = [Infinity, Infinity, Infinity], most = [-Infinity, -Infinity, -Infinity];
      for (let i = 0; i < focus.length; i++) {
        least[i % 3] = Math.min(least[i % 3], focus[i]);
        most[i % 3] = Math.max(most[i % 3], focus[i]);
      }
      const specks = new Float32Array(3 * 1500), around = (data.herd ? 2 : 4) * radius;
      for (let i = 0; i < specks.length; i++) {
        const k = i % 3;
        const from = k === 2 ? data.floor : least[k] - around;
        const to = most[k] + (k === 2 ? 2 * radius : around);
        specks[i] = from + chance() * (to - from);
      }
      const places = new THREE.BufferGeometry();
      places.setAttribute("position", new THREE.BufferAttribute(specks, 3));
      cloud = new THREE.Points(places, new THREE.PointsMaterial({
        color: "#bfeee8", size: 0.016 * radius, transparent: true, opacity: 0.6,
      }));
      scene.add(cloud);
    }

    const here = new THREE.Vector3(), there = new THREE.Vector3(), middle = new THREE.Vector3();
    const turn = new THREE.Quaternion(), next = new THREE.Quaternion();
    // Moves everything to an instant, and returns the place that the camera follows.
    function pose(motion, now) {
      const { count, rate, focus } = motion;
      const frame = Math.min(now * rate, count - 1);
      const i = Math.min(Math.floor(frame), Math.max(count - 2, 0));
      const fraction = count > 1 ? frame - i : 0;
      const j = Math.min(i + 1, count - 1);
      for (const { bodies, motion: alone } of herd) {
        const { position, rotation } = alone || motion;
        bodies.forEach((body, b) => {
          const one = i * bodies.length + b, two = j * bodies.length + b;
          here.fromArray(position, 3 * one);
          body.position.copy(here.lerp(there.fromArray(position, 3 * two), fraction));
          turn.fromArray(rotation, 4 * one).normalize();
          body.quaternion.copy(turn.slerp(next.fromArray(rotation, 4 * two).normalize(), fraction));
        });
      }
      for (const { map, drift } of tiles) {
        const ahead = [0, 1].map((k) => drift[2 * i + k] * (1 - fraction) + drift[2 * j + k] * fraction);
        map.offset.set(...ahead.map((far, k) => (far - data.tiles.size[k] / 2) / tile));
      }
      if (motion.lights) {
        const [one, two] = [i, j].map((k) => Math.min(3 * k, motion.lights.length - 3));
        here.fromArray(motion.lights, one);
        there.fromArray(motion.lights, two);
        // Nothing is between two places of a light that jumps.
        const jumps = here.distanceTo(there) > 0.3 * radius;
        light.position.copy(here.lerp(there, jumps ? Math.round(fraction) : fraction));
      }
      here.fromArray(focus, 3 * i).lerp(there.fromArray(focus, 3 * j), fraction);
      middle.copy(here);
      sun.target.position.copy(here);
      sun.position.copy(here).add(fromSun);
      if (floor) {
        const whole = (x) => tile * Math.round(x / tile);
        floor.position.set(whole(here.x), whole(here.y), data.floor);
      }
      if (surface) surface.position.set(here.x, here.y, data.surface);
      // Trail and specks belong to the scene's own motion.
      line.visible = motion === own;
      if (cloud) cloud.visible = motion === own;
      trail.setDrawRange(Math.max(0, i - 8 * rate), Math.min(i, 8 * rate) + 1);
      return { here, frame: i };
    }
    // Puts an arrow at the edge of the picture, if the light is outside.
    function point(camera) {
      camera.updateMatrixWorld();
      const { x, y, z } = there.copy(light.position).project(camera);
      arrow.visible = Math.abs(x) > 1 || Math.abs(y) > 1 || Math.abs(z) > 1;
      const high = Math.tan((camera.fov / 360) * Math.PI) * camera.position.distanceTo(middle);
      there.copy(light.position).applyMatrix4(camera.matrixWorldInverse);
      const edge = Math.min(
        (0.9 * high * camera.aspect) / Math.abs(there.x), (0.85 * high) / Math.abs(there.y),
      );
      const along = Math.atan2(there.y, there.x) - Math.PI / 2;
      there.set(edge * there.x, edge * there.y, -camera.position.distanceTo(middle));
      arrow.position.copy(camera.localToWorld(there));
      arrow.quaternion.copy(camera.quaternion).multiply(turn.setFromAxisAngle(here.set(0, 0, 1), along));
    }
    function render(renderer, camera) {
      if (sky) sky.position.copy(camera.position);
      if (data.light !== null) point(camera);
      renderer.render(scene, camera);
    }
    function dispose() {
      scene.traverse((thing) => {
        thing.geometry?.dispose();
        thing.material?.map?.dispose();
        thing.material?.dispose();
        if (thing.isInstancedMesh) thing.dispose();
      });
      for (const { skins } of herd) skins[0]?.skeleton.dispose();
      sun.dispose();
    }
    const away = (data.water ? 4.3 : 4.4) * radius;
    const views = {
      side: [data.bearing - Math.PI / 2 + 0.35, data.elevation ?? (data.water ? 0.42 : 0.24)],
      top: [data.bearing - Math.PI / 2, 1.5],
      behind: [data.bearing + Math.PI + 0.12, 0.35],
      front: [data.bearing + 0.3, 0.25],
    };
    // Returns the place of the camera relative to the animal.
    function offset(view) {
      const [around, up] = views[view];
      return new THREE.Vector3(
        Math.cos(around) * Math.cos(up), Math.sin(around) * Math.cos(up), Math.sin(up),
      ).multiplyScalar(away);
    }
    // Returns the number of the animal at a place in the picture, -1 to 1, or undefined.
    const ray = new THREE.Raycaster();
    function at(place, camera) {
      ray.setFromCamera(place, camera);
      let [thing] = ray.intersectObjects(herd.flatMap(({ things }) => things)).map((hit) => hit.object);
      while (thing && thing.userData.number === undefined) thing = thing.parent;
      return thing?.userData.number;
    }
    return { data, own, sight, array, pose, render, offset, dispose, at };
  }

  // Returns a camera for a scene, as wide as the canvas.
  function cameraOf({ data }) {
    const made = new THREE.PerspectiveCamera(32, 16 / 9, 0.02 * data.radius, 80 * data.radius);
    made.up.set(0, 0, 1);
    return made;
  }
  function fitted(camera, aspect, wide = 1.4) {
    camera.aspect = aspect;
    // A narrow window shows as much of the animal as a wide one.
    camera.fov = aspect < wide ? 32 * Math.min(1.8, wide / aspect) : 32;
    camera.updateProjectionMatrix();
  }

  // ---- the player
  // Returns a player in an element, or null without WebGL. `show` gives it a scene. A further
  // scene, such as that of a new champion, goes on at the same instant.
  function player(stage) {
    const canvas = stage.querySelector("canvas");
    const button = stage.querySelector(".play");
    const slider = stage.querySelector("input[type=range]");
    const clock = stage.querySelector(".clock");
    const caption = stage.querySelector(".caption");
    const pace = stage.querySelector(".pace");
    const following = stage.querySelector(".follow");
    const renderer = rendererOf(canvas);
    if (!renderer) {
      // The still picture stays.
      stage.classList.add("still-only");
      return null;
    }
    renderer.shadowMap.enabled = true;
    renderer.shadowMap.type = THREE.PCFShadowMap;
    const anisotropy = renderer.capabilities.getMaxAnisotropy();
    let world = null, data = null, duration = 0, camera = null, controls = null;
    let view = "side", pointed = null;
    let now = 0, playing = false, last = 0, waiting = false;
    const there = new THREE.Vector3();

    function show(scene) {
      const first = world === null;
      world?.dispose();
      data = scene;
      world = worldOf(data, anisotropy);
      duration = world.own.duration;
      slider.max = duration;
      slider.step = 1 / data.rate;
      now = Math.min(now, duration);
      if (first) take();
      else if (!following.checked) view = null;
      controls.minDistance = 1.2 * data.radius;
      controls.maxDistance = 0.9 * world.sight;
      stage.classList.add("ready");
      fit();
      pose();
      if (view) from(view);
      if (first && !matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
    }

    // ---- the camera
    function take() {
      camera = cameraOf(world);
      controls = new THREE.OrbitControls(camera, canvas);
      controls.enableDamping = false;
      // The wheel scrolls the page. With Ctrl or Shift held, it zooms.
      controls.enableZoom = false;
      controls.addEventListener("change", draw);
      controls.addEventListener("start", () => { view = null; });
      new ResizeObserver(fit).observe(canvas);
    }
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && !event.shiftKey) return;
      event.preventDefault();
      const by = event.deltaY || event.deltaX;
      zoom(Math.exp(Math.max(-60, Math.min(60, by)) / 300));
    }, { passive: false });
    function zoom(factor) {
      const offset = camera.position.clone().sub(controls.target).multiplyScalar(factor);
      const length = Math.max(controls.minDistance, Math.min(controls.maxDistance, offset.length()));
      camera.position.copy(controls.target).add(offset.setLength(length));
      view = null;
      draw();
    }
    function from(chosen) {
      view = chosen;
      camera.position.copy(world.offset(view)).add(controls.target);
      controls.update();
      draw();
    }

    // ---- time
    const cursors = [...document.querySelectorAll(".timed")].map((drawing) => {
      const bar = document.createElement("div");
      bar.className = "cursor";
      drawing.append(bar);
      const { left, right, start, stop } = drawing.dataset;
      const axis = { left: +left, right: +right, start: +start, stop: +stop };
      drawing.addEventListener("click", (event) => {
        const box = drawing.getBoundingClientRect();
        const across = (event.clientX - box.left) / box.width;
        const fraction = (across - axis.left) / (axis.right - axis.left);
        if (fraction >= 0 && fraction <= 1) {
          seek(axis.start + fraction * (axis.stop - axis.start) - data.start);
        }
      });
      return { bar, axis };
    });
    function pose() {
      const { here, frame } = world.pose(world.own, now);
      if (following.checked) {
        camera.position.add(there.copy(here).sub(controls.target));
        controls.target.copy(here);
      }
      slider.value = now;
      const shown = data.start + now;
      clock.textContent = `${shown.toFixed(1)} / ${(data.start + duration).toFixed(1)} s`;
      slider.setAttribute("aria-valuetext", `${shown.toFixed(1)} s`);
      caption.textContent = words(frame);
      for (const { bar, axis } of cursors) {
        const part = (shown - axis.start) / (axis.stop - axis.start);
        bar.hidden = part < 0 || part > 1;
        bar.style.left = `${100 * (axis.left + (axis.right - axis.left) * part)}%`;
      }
      draw();
    }
    function words(frame) {
      const grid = `grid ${+data.spacing.toPrecision(3)} m`;
      if (data.herd) return `${data.herd[pointed]?.words ?? "Point at an animal"} · ${grid}`;
      const [speed, distance] = [data.speed, data.distance].map((each) => world.array(each, "f4")[frame]);
      return `${speed.toFixed(2)} m/s · ${distance.toFixed(2)} m ${data.measured} · ${grid}`;
    }
    function point(event) {
      if (!data?.herd) return;
      const box = canvas.getBoundingClientRect();
      const right = (event.clientX - box.left) / box.width, up = (box.bottom - event.clientY) / box.height;
      pointed = world.at(new THREE.Vector2(2 * right - 1, 2 * up - 1), camera) ?? pointed;
      caption.textContent = words(0);
    }
    canvas.addEventListener("pointermove", point);
    canvas.addEventListener("pointerdown", point);
    function draw() {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame((instant) => {
        waiting = false;
        if (playing) {
          // The time of a frame may be earlier than the click that started playback.
          now += Math.max(0, Math.min(instant - last, 100)) / 1000 * +pace.value;
          last = instant;
          if (now > duration) now = 0;
          pose();
        }
        world.render(renderer, camera);
      });
    }
    function seek(instant) {
      now = Math.max(0, Math.min(duration, instant));
      pose();
    }
    function play(on) {
      playing = on;
      last = performance.now();
      button.textContent = on ? "Pause" : "Play";
      button.setAttribute("aria-pressed", on);
      draw();
    }
    button.addEventListener("click", () => play(!playing));
    slider.addEventListener("input", () => { play(false); seek(+slider.value); });
    following.addEventListener("change", () => pose());
    stage.querySelectorAll("[data-view]").forEach((each) => {
      each.addEventListener("click", () => from(each.dataset.view));
    });
    stage.querySelectorAll("[data-zoom]").forEach((each) => {
      each.addEventListener("click", () => zoom(+each.dataset.zoom));
    });
    canvas.addEventListener("keydown", (event) => {
      const by = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
      if (event.key === " ") play(!playing);
      else if (by) { play(false); seek(now + by / data.rate); }
      else return;
      event.preventDefault();
    });
    function fit() {
      const box = canvas.getBoundingClientRect();
      if (!box.width) return;
      renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
      renderer.setSize(box.width, box.height, false);
      fitted(camera, box.width / box.height, data.herd ? 16 / 9 : undefined);
      draw();
    }
    return { show, get time() { return now; } };
  }

  return { cameraOf, decoder, fitted, motionOf, player, rendererOf, worldOf };
})();

// The page of a run holds the scene of its champion.
const champion = document.getElementById("scene");
if (champion) {
  Viewer.player(document.getElementById("animal"))?.show(JSON.parse(champion.textContent));
}
