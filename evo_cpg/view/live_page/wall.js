// The wall of the population: many animals that move side by side on one canvas. Needs Viewer.
"use strict";
const Wall = (() => {
  // Frames per second, and distance of the camera in multiples of the player's.
  const RATE = 20, NEAR = 0.7;

  // Returns a wall in an element with a canvas and a list, or null without WebGL.
  function wall(element, pause) {
    const canvas = element.querySelector("canvas"), list = element.querySelector("ol");
    const renderer = Viewer.rendererOf(canvas);
    if (!renderer) return null;
    renderer.setScissorTest(true);
    renderer.setClearAlpha(0);
    const anisotropy = renderer.capabilities.getMaxAnisotropy();
    let world = null, camera = null, tiles = [];
    let playing = !matchMedia("(prefers-reduced-motion: reduce)").matches;
    let now = 0, last = 0, seen = false;

    // Begins a wall with empty places, in the scene of the champion.
    function begin(scene, count) {
      world?.dispose();
      world = Viewer.worldOf(scene, anisotropy);
      camera = Viewer.cameraOf(world);
      tiles = [];
      list.replaceChildren(...Array.from({ length: count }, () => document.createElement("li")));
      draw();
    }
    // Fills the next places.
    function add(found) {
      for (const { place, value, fitness, motion } of found) {
        const item = list.children[tiles.length], words = document.createElement("span");
        words.textContent = motion ? fitness : "diverged";
        item.append(words);
        item.title = `individual ${place}`;
        if (motion) item.classList.add("there");
        tiles.push({ item, value: motion ? value : null, motion: motion && Viewer.motionOf(motion, Viewer.decoder(motion.arrays)) });
      }
      const best = Math.max(...tiles.map(({ value }) => value ?? -Infinity));
      for (const { item, value } of tiles) item.classList.toggle("best", value === best);
      draw();
    }
    function draw() {
      const box = canvas.getBoundingClientRect();
      if (!world || !box.width) return;
      const size = renderer.getSize(new THREE.Vector2());
      if (Math.round(size.x) !== Math.round(box.width) || Math.round(size.y) !== Math.round(box.height)) {
        renderer.setPixelRatio(Math.min(devicePixelRatio, 1.5));
        renderer.setSize(box.width, box.height, false);
      }
      for (const { item, motion } of tiles) {
        const own = item.getBoundingClientRect();
        if (!motion || own.bottom < 0 || own.top > innerHeight) continue;
        const { here } = world.pose(motion, now % motion.duration);
        Viewer.fitted(camera, own.width / own.height);
        camera.position.copy(world.offset("side")).multiplyScalar(NEAR).add(here);
        camera.lookAt(here);
        const at = [own.left - box.left, box.bottom - own.bottom, own.width, own.height];
        renderer.setViewport(...at);
        renderer.setScissor(...at);
        world.render(renderer, camera);
      }
    }
    function step(instant) {
      requestAnimationFrame(step);
      if (!playing || !seen || instant - last < 1000 / RATE) return;
      now += Math.min(instant - last, 200) / 1000;
      last = instant;
      draw();
    }
    function play(on) {
      playing = on;
      pause.textContent = on ? "Pause" : "Play";
      pause.setAttribute("aria-pressed", !on);
    }
    pause.addEventListener("click", () => play(!playing));
    new IntersectionObserver(([entry]) => { seen = entry.isIntersecting; draw(); }).observe(element);
    new ResizeObserver(draw).observe(element);
    addEventListener("scroll", draw, { passive: true });
    play(playing);
    requestAnimationFrame(step);
    return { add, begin, get time() { return now; } };
  }
  return { wall };
})();
