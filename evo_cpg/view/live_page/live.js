// Asks the server for what is new, and shows it. Needs Viewer and Wall.
"use strict";
(() => {
  const token = new URLSearchParams(location.search).get("token") || "";
  const $ = (id) => document.getElementById(id);
  const INTERVAL = 1000;
  const player = Viewer.player($("animal"));
  const wall = Wall.wall($("wall"), $("pause"));
  const known = { chart: 0, motion: 0, wall: 0, tiles: 0 };
  let scene = null;

  function status(kind, words) {
    $("status").dataset.kind = kind;
    // A screen reader reads it only if it changes.
    if ($("status").textContent !== `${words}.`) $("status").textContent = `${words}.`;
  }
  function showNumbers(numbers) {
    $("numbers").replaceChildren(...numbers.map(([value, name]) => {
      const item = document.createElement("li"), bold = document.createElement("b"), words = document.createElement("span");
      bold.textContent = value;
      words.textContent = name;
      item.append(bold, words);
      return item;
    }));
  }
  function take({ status: { kind, words }, numbers, chart, motion, wall: filled }) {
    status(kind, words);
    showNumbers(numbers);
    if (chart) {
      $("curves").innerHTML = chart.html;
      known.chart = chart.number;
    }
    if (motion) {
      known.motion = motion.number;
      $("champion").textContent = motion.words;
      if (!player) $("before").textContent = "This browser has no WebGL, so the animal is not drawn.";
      else if (motion.scene) player.show(scene = motion.scene);
      else if (!scene) $("before").textContent = "";
    }
    if (filled && wall && scene) {
      $("population").hidden = false;
      if (filled.number !== known.wall) {
        known.tiles = 0;
        wall.begin(scene, filled.count);
      }
      known.wall = filled.number;
      known.tiles += filled.tiles.length;
      $("which").textContent = `${filled.words}.`;
      wall.add(filled.tiles);
    }
    document.body.dataset.answers = Number(document.body.dataset.answers || 0) + 1;
  }
  // Returns the answer of the server, or null if it has ended.
  async function asked() {
    try {
      const answer = await fetch(`/state?${new URLSearchParams(known)}`, { headers: { "X-Token": token } });
      return answer.ok ? await answer.json() : null;
    } catch (error) {
      return null;
    }
  }
  async function poll() {
    const answer = await asked();
    setTimeout(poll, INTERVAL);
    if (!answer) status("lost", "evo-cpg watch has ended. The page keeps what it shows");
    else take(answer);
  }
  poll();
})();
