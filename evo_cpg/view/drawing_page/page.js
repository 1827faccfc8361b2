// The page around the 3-D view: tree of parts, panel, messages, try and train. Needs View.
"use strict";
(() => {
  const token = new URLSearchParams(location.search).get("token") || "";
  const $ = (id) => document.getElementById(id);
  let state = null, chosen = null, adding = null, busy = 0, kept = false;

  // ---- requests
  async function send(path, body, method = "POST") {
    busy += 1;
    document.body.dataset.busy = busy;
    try {
      const answer = await fetch(path, { method, body, headers: { "X-Token": token } });
      return await answer.json();
    } catch (error) {
      notice("The program does not answer. Saved files and the autosave keep your work. Start evo-cpg model again.", true);
      return { error: "no answer" };
    } finally {
      busy -= 1;
      document.body.dataset.busy = busy;
    }
  }
  // One request after the other, so that answers arrive in order.
  let queue = Promise.resolve();
  function request(name, given = {}) {
    const answer = queue.then(() => send(`/${name}`, JSON.stringify({ ...given, ...(name === "open" || !state ? {} : { seen: state.revision }) })));
    queue = answer.then(take, () => {});
    return queue.then(() => answer);
  }
  let answers = 0;
  function take(answer) {
    document.body.dataset.answers = answers += 1;
    if (answer.data) {
      state = answer;
      render();
    }
    if (answer.error) notice(answer.error, true);
    else if (answer.saved) notice(`Saved ${answer.saved}`);
    else if (answer.unsafe) notice(`There is no autosave: ${answer.unsafe}. Save under another name or free some space.`, true);
    else if (answer.data) notice("");
  }
  async function edit(command, given) {
    let answer = await request("edit", { command, given });
    if (answer.lost) {
      const yes = await ask("This edit removes lines of the file with these comments:", { lost: answer.lost.join("\n") });
      if (yes === null) {
        render();
        return answer;
      }
      answer = await request("edit", { command, given, accept: true });
    }
    if (answer.new) choose(answer.new);
    return answer;
  }
  function notice(words, wrong = false) {
    $("notice").textContent = words;
    $("notice").hidden = !words;
    $("notice").className = wrong ? "error" : "";
  }
  // Returns the text of the field, or null if it was not confirmed. With two choices it returns
  // true for the first, false for the second, and null if the dialog was closed.
  function ask(question, { lost = "", words = null, value = "", choices = null, act = "Continue" } = {}) {
    const dialog = $("dialog");
    [$("yes").textContent, $("no").textContent] = choices || [act, "Cancel"];
    $("question").textContent = question;
    $("lost").textContent = lost;
    $("lost").hidden = !lost;
    $("asked").hidden = words === null;
    $("asked-words").textContent = words || "";
    $("answer").value = value;
    $("answer").disabled = words === null;
    dialog.returnValue = "";
    dialog.showModal();
    $("yes").focus();
    if (words !== null) $("answer").select();
    return new Promise((done) => {
      dialog.addEventListener("close", () => {
        const chosen = dialog.returnValue;
        if (choices) done(chosen ? chosen === "yes" : null);
        else done(chosen === "yes" ? $("answer").value : null);
      }, { once: true });
    });
  }

  // ---- small elements
  function make(name, attributes = {}, ...children) {
    const made = document.createElement(name);
    for (const [key, value] of Object.entries(attributes)) {
      if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
      else if (key in made && key !== "list") made[key] = value;
      else made.setAttribute(key, value);
    }
    made.append(...children.filter((child) => child !== null));
    return made;
  }
  // Only a button of type submit is pressed by Enter in the field.
  $("no").addEventListener("click", () => $("dialog").close("no"));
  const button = (words, act, more = {}) => make("button", { type: "button", onclick: act, ...more }, words);
  function row(label, ...inputs) {
    return make("div", { className: "row" }, make("span", {}, label), ...inputs);
  }
  // A field of text. A wrong entry returns to the last value.
  function field(label, value, act, more = {}) {
    return make("input", {
      value: value ?? "", "aria-label": label, ...more,
      onchange: (event) => act(event.target.value.trim()),
    });
  }
  function number(label, value, act, optional = false) {
    return field(label, value, (text) => {
      const given = text === "" ? null : Number(text);
      if (Number.isNaN(given) || (given === null && !optional)) {
        notice(`${label}: ${text || "nothing"} is not a number`, true);
        renderPanel();
      } else act(given);
    }, { inputMode: "decimal" });
  }
  function numbers(label, values, act) {
    return values.map((value, i) => number(`${label} ${"xyz"[i] || i}`, value, (given) => act(values.map((old, k) => (k === i ? given : old)))));
  }
  const set = (key, value) => (value === undefined || value === null ? edit("unset_value", { key }) : edit("set_value", { key, value }));

  // ---- selection
  const entries = () => state.data.creature?.bodies || [];
  const entry = (name) => entries().find((each) => each.name === name);
  function bodyOf(name) {
    const drawn = state.scene?.bodies || [];
    return drawn.find((each) => each.name === name) || drawn.find((each) => each.entry === name);
  }
  function choose(name) {
    chosen = name;
    const body = name && state.scene && bodyOf(name);
    View?.select(body ? body.name : null);
    render();
  }
  const chosenEntry = () => entry(bodyOf(chosen)?.entry ?? chosen);

  // ---- tree
  function renderTree() {
    const all = entries(), own = bodyOf(chosen)?.entry ?? chosen, seen = new Set();
    function parentOf(each) {
      const name = each.joint?.parent;
      return name === undefined ? null : all.find((other) => other.name === name) || entry(bodyOf(name)?.entry) || null;
    }
    function item(each) {
      if (seen.has(each)) return null;
      seen.add(each);
      const copies = state.scene?.bodies.find((body) => body.entry === each.name)?.copies ?? 1;
      const found = state.problems.filter((problem) => problem.part === each.name);
      const kind = found.some((problem) => problem.kind === "error") ? "error" : "warning";
      const marks = make("span", { className: "count" }, copies > 1 ? ` \u00d7 ${copies}` : "");
      const flag = found.length ? make("span", { className: kind, title: found.map((x) => x.words).join("\n") }, " \u25b2") : null;
      const select = button("", () => choose(each.name), { role: "treeitem", "aria-selected": String(each.name === own), "data-part": each.name });
      select.append(each.name, marks, ...(flag ? [flag] : []));
      const below = all.filter((other) => other !== each && parentOf(other) === each).map(item).filter(Boolean);
      return make("li", {}, select, below.length ? make("ul", {}, ...below) : null);
    }
    const roots = all.filter((each) => parentOf(each) === null).map(item);
    const rest = all.filter((each) => !seen.has(each)).map(item).filter(Boolean);
    $("tree").replaceChildren(...roots, ...rest);
  }
  // Buttons that mend a problem, by words of its message.
  const CURES = [["has no eye", "add-eye"], ["at least one joint", "add-part"]];
  function renderProblems() {
    const items = state.problems.map((problem) => {
      const [first, ...rest] = problem.words.split(/(?<=[.!]) (?=[A-Z])/);
      const where = problem.part || problem.key.join(".");
      const name = problem.part
        ? button(where, () => choose(problem.part), { className: problem.kind })
        : make("b", { className: problem.kind }, where || "file");
      const inside = problem.part ? problem.key.slice(3).join(".") : "";
      const cure = CURES.find(([words]) => problem.words.includes(words))?.[1];
      return make("li", {}, name, `${inside && " "}${inside}: ${first}`,
        rest.length ? make("details", {}, make("summary", {}, "more"), rest.join(" ")) : null,
        cure ? button($(cure).textContent, () => $(cure).click(), { className: "cure" }) : null);
    });
    if (!items.length) items.push(make("li", { className: "count" }, state.checked ? "none: the animal can be trained" : "checking..."));
    $("problems").replaceChildren(...items);
  }

  // ---- panel
  const Form = Forms({ make, button, row, number, numbers, set, edit });
  function renderPanel() {
    const each = chosen ? chosenEntry() : null;
    $("panel").replaceChildren(...(each ? partPanel(each) : worldPanel()));
  }
  function partPanel(each) {
    const at = entries().indexOf(each), key = ["creature", "bodies", at];
    const name = each.name, body = bodyOf(chosen) || bodyOf(name);
    const own = state.problems.filter((problem) => problem.part === name);
    const materials = Object.keys(state.data.creature.materials || {});
    const made = [
      make("h2", {}, "Part"),
      ...own.map((problem) => make("p", { className: problem.kind }, `${problem.key.slice(3).join(".")}: ${problem.words}`)),
      row("name", field("name", name, (text) => edit("rename_part", { name, new: text }).then((answer) => { if (!answer.error && !answer.lost) choose(text); }))),
      ...Form.shape(name, each.shape, [...key, "shape"], { section: View?.section ?? null, chooseSection }),
      row("mesh file", make("input", { type: "file", accept: ".glb,.stl,.obj,.ply,.off", "aria-label": "mesh file", onchange: (event) => upload(event.target.files[0], key) })),
      row("material", Form.select("material", each.material, materials, (word) => set([...key, "material"], word))),
      row("color", make("input", { type: "color", "aria-label": "color", value: each.color || body?.color || "#888888", onchange: (event) => set([...key, "color"], event.target.value) }),
        each.color ? button("default", () => set([...key, "color"], null)) : null),
    ];
    if (body) made.push(row("mass", make("span", {}, `${body.mass.toPrecision(3)} kg`)));
    made.push(...Form.furtherShapes(each, key, materials));
    if (each.joint) made.push(...jointPanel(each, key, body));
    if (each.joint && each.joint.parent !== "world") made.push(...copyPanel(each));
    made.push(...sensorPanel(each, body));
    made.push(make("h3", {}, ""), button(each.joint ? "Remove this part and what it carries" : "The root cannot be removed", () => edit("remove_part", { name }).then((answer) => { if (!answer.error && !answer.lost) choose(null); }), { id: "remove", disabled: !each.joint }));
    return made;
  }
  function chooseSection(index) {
    View?.chooseSection(index);
    renderPanel();
    hint();
  }
  function jointPanel(each, key, body) {
    const joint = each.joint;
    const put = (part) => (value) => set([...key, "joint", part], value);
    const made = [make("h3", {}, "Joint"), row("on", field("parent", joint.parent, put("parent")))];
    for (const part of ["at", "child_at"]) made.push(row(part === "at" ? "at (m)" : "in this part (m)", ...numbers(part, joint[part] || [0, 0, 0], put(part))));
    made.push(row("turned (\u00b0)", ...numbers("rotation_deg", joint.rotation_deg || [0, 0, 0], (value) => (value.some(Boolean) ? put("rotation_deg")(value) : set([...key, "joint", "rotation_deg"], null)))));
    return [...made, ...Form.joint(each, key, body)];
  }
  function copyPanel(each) {
    const name = each.name, made = [make("h3", {}, "Copies")];
    const copies = bodyOf(name)?.copies ?? 1;
    made.push(row("in a row", number("repeat", each.repeat ?? 1, (count) => edit("repeat", { name, count }))));
    made.push(row("in a star", number("radial", each.radial ?? 1, (count) => edit("radial", { name, count }))));
    made.push(make("div", { className: "row" },
      each.mirror ? make("span", {}, `mirrored: ${each.mirror}`) : button("Mirror left and right", () => edit("mirror", { name }), { id: "mirror" }),
      copies > 1 ? button("Separate the copies", () => edit("separate", { name }).then(() => choose(null)), { id: "separate" }) : null));
    if (copies > 1) made.push(make("p", { className: "count" }, `This is one of ${copies} copies. An edit changes all of them.`));
    return made;
  }
  function sensorPanel(each, body) {
    const made = [make("h3", {}, "Sensors")], creature = state.data.creature;
    const pressed = creature.pressure_sensors ?? "all";
    const on = pressed === "all" || pressed.includes(each.name) || (body && pressed.includes(body.name));
    made.push(row("pressure", make("input", { type: "checkbox", "aria-label": "pressure sensor", checked: on, onchange: () => edit("set_pressure", { part: each.name, on: !on }) })));
    const carried = new Set((state.scene?.bodies || []).filter((other) => other.entry === each.name).map((other) => other.name));
    (creature.light_sensors || []).forEach((eye, i) => {
      if (eye.body !== each.name && !carried.has(eye.body)) return;
      const at = ["creature", "light_sensors", i];
      made.push(row(`eye ${i + 1}`, make("span", {}, eye.body === each.name ? "" : `on ${eye.body}`), button("remove", () => edit("remove_sensor", { kind: "light_sensors", index: i }))));
      made.push(row("position (m)", ...numbers(`eye ${i + 1} position`, eye.position || [0, 0, 0], (value) => set([...at, "position"], value))));
      made.push(row("looks along", ...numbers(`eye ${i + 1} axis`, eye.axis || [1, 0, 0], (value) => set([...at, "axis"], value))));
      made.push(row("field of view (\u00b0)", number(`eye ${i + 1} field of view`, eye.field_of_view_deg ?? 180, (value) => set([...at, "field_of_view_deg"], value))));
    });
    (creature.depth_sensors || []).forEach((gauge, i) => {
      if (gauge.body !== each.name && !carried.has(gauge.body)) return;
      const at = ["creature", "depth_sensors", i];
      made.push(row(`depth gauge ${i + 1}`, make("span", {}, gauge.body === each.name ? "" : `on ${gauge.body}`), button("remove", () => edit("remove_sensor", { kind: "depth_sensors", index: i }))));
      made.push(row("position (m)", ...numbers(`gauge ${i + 1} position`, gauge.position || [0, 0, 0], (value) => set([...at, "position"], value))));
      made.push(row("full scale (m)", number(`gauge ${i + 1} full scale`, gauge.full_scale ?? 1, (value) => set([...at, "full_scale"], value))));
    });
    return made;
  }
  function worldPanel() {
    const world = state.data.world || {}, made = [make("h2", {}, "World")];
    const water = world.water === undefined ? {} : world.water;
    const put = (...key) => (value) => set(["world", ...key], value);
    made.push(row("gravity (m/s\u00b2)", number("gravity", world.gravity ?? 9.81, put("gravity"))));
    made.push(row("water", make("input", { type: "checkbox", "aria-label": "water", checked: Boolean(water), onchange: () => edit("set_water", { on: !water }) })));
    if (water) {
      made.push(row("surface (m)", number("surface", water.surface, (value) => edit("set_water", { on: true, surface: value }), true), make("span", { className: "count" }, water.surface == null ? "everywhere" : "")));
      made.push(row("current (m/s)", ...numbers("current", water.current || [0, 0, 0], (value) => put("water", "current")(value.some(Boolean) ? value : null))));
      made.push(row("viscosity (Pa s)", number("viscosity", water.viscosity, put("water", "viscosity"), true)));
    }
    made.push(row("ground", make("input", { type: "checkbox", "aria-label": "ground", checked: Boolean(world.ground), onchange: () => edit("set_ground", { on: !world.ground }) })));
    made.push(make("h2", {}, "Goal"));
    const task = state.data.task || { type: "reach_light" }, kind = task.type || "reach_light";
    made.push(row("task", make("select", { "aria-label": "task", onchange: (event) => set(["task"], event.target.value === "reach_light" ? null : { type: event.target.value }) },
      ...[...new Set(["reach_light", "walk", "distance", kind])].map((word) => make("option", { value: word, selected: word === kind }, word)))));
    if (kind === "reach_light") {
      const light = task.light || {};
      if (light.at) made.push(row("light at (m)", ...numbers("light", light.at, (value) => set(["task", "light", "at"], value))));
      else {
        made.push(row("distance (m)", number("light distance", light.distance ?? 8, (value) => set(["task", "light", "distance"], value))));
        made.push(row("to the left (\u00b0)", number("light bearing", light.bearing_deg ?? 30, (value) => set(["task", "light", "bearing_deg"], value))));
        made.push(row("above (\u00b0)", number("light elevation", light.elevation_deg ?? 0, (value) => set(["task", "light", "elevation_deg"], value))));
      }
    }
    made.push(make("h2", {}, "Materials"));
    const materials = state.data.creature?.materials || {};
    for (const [name, material] of Object.entries(materials)) {
      made.push(row(name, number(`density of ${name}`, material.density, (value) => set(["creature", "materials", name, "density"], value)), make("span", { className: "count" }, "kg/m\u00b3")));
    }
    made.push(button("Add a material", async () => {
      const name = await ask("Add a material", { words: "name", value: `material${Object.keys(materials).length + 1}` });
      if (name) edit("set_value", { key: ["creature", "materials", name], value: { density: 1000 } });
    }));
    if (state.scene) {
      const { bodies, axes, mass, length } = state.scene;
      made.push(make("p", { className: "count" }, `${bodies.length} ${bodies.length === 1 ? "body" : "bodies"}, ${axes} joint ${axes === 1 ? "axis" : "axes"}, ${mass.toPrecision(3)} kg, ${length.toPrecision(3)} m long`));
    }
    return made;
  }
  async function upload(file, key) {
    if (!file) return;
    const answer = await send(`/upload?name=${encodeURIComponent(file.name)}`, file);
    if (answer.error) return notice(answer.error, true);
    if (answer.problem) {
      const yes = await ask(`${file.name} is no body as it is: ${answer.problem}. Use its convex hull?`);
      if (yes === null) return renderPanel();
    }
    await set([...key, "shape"], { type: "mesh", file: answer.file, ...(answer.problem ? { hull: true } : {}) });
  }

  // ---- the whole page
  function render() {
    $("path").textContent = `${state.path}${state.changed ? " (not saved)" : ""}`;
    document.title = `${state.changed ? "* " : ""}${state.data.name} - evo-cpg model`;
    $("undo").disabled = !state.undo;
    $("redo").disabled = !state.redo;
    $("recovered").hidden = kept || !state.recovered;
    $("text").textContent = [state.text[0], state.text[1]].filter((text) => text !== null).join("\n# ---- the creature's own file\n");
    if (chosen && !chosenEntry()) chosen = null;
    if (drawnState !== state) {
      drawnState = state;
      View?.show(state);
      const body = chosen && bodyOf(chosen);
      View?.select(body ? body.name : null);
      $("player").hidden = true;
      check();
    }
    renderTree();
    renderProblems();
    renderPanel();
    hint();
  }
  let drawnState = null, checking = null;
  // The messages that take longer come when the edits pause.
  function check() {
    clearTimeout(checking);
    checking = setTimeout(async () => {
      const asked = state.revision, found = await send("/check", "{}");
      if (found.revision === asked && state.revision === asked) {
        state.problems = found.problems;
        state.checked = true;
        renderTree();
        renderProblems();
        // A field with the focus keeps it.
        if (!$("panel").contains(document.activeElement)) renderPanel();
      }
    }, 300);
  }
  function hint() {
    let words = adding ? `Click the surface where the new ${adding} shall sit. Escape cancels.` : "";
    if (state.undrawn) words = `Not drawn: ${state.undrawn.replace(`${state.path}: `, "")}`;
    else if (!adding && chosen && bodyOf(chosen)?.sections?.length) words = View?.section === null ? "Click the dot of a section to move it or to stretch it." : "Move or stretch the section with the gizmo. Click its dot again for the part.";
    else if (!adding && !chosen) words = "Click a part to select it. Drag to turn the view, right-drag to move it. The arrow points ahead.";
    $("hint").textContent = View ? words : "This browser has no WebGL, so the animal is not drawn. The fields work.";
    for (const each of document.querySelectorAll("[data-add]")) each.setAttribute("aria-pressed", String(each.dataset.add === adding));
  }
  function setAdding(what) {
    adding = adding === what ? null : what;
    View?.arm(Boolean(adding));
    hint();
  }

  async function place(found) {
    const what = adding;
    setAdding(what);
    const copies = bodyOf(found.name)?.copies ?? 1, carrier = entry(found.entry);
    let each = true;
    // Limbs get one on each side. In a row, the answer decides.
    if (copies > 1 && what !== "shape" && (carrier?.repeat ?? 1) > 1) {
      each = await ask(`${found.name} is one of ${copies} bodies in a row. Add the ${what} to`, { choices: [`all ${copies}`, `${found.name} only`] });
      if (each === null) return;
    }
    if (what === "gauge") {
      await edit("add_depth_gauge", { part: found.name, place: found.place, each });
      choose(found.name);
    } else if (what === "eye") {
      await edit("add_eye", { part: found.name, place: found.place, axis: found.normal, each });
      choose(found.name);
    } else if (what === "shape") {
      await edit("add_shape", { part: found.name, place: found.place, normal: found.normal });
      choose(found.name);
    } else await edit("add_part", { parent: found.name, place: found.place, normal: found.normal, each });
  }

  if (View) {
    View.events.pick = (found) => {
      if (adding && found) place(found);
      else if (!adding) choose(found ? found.name : null);
    };
    View.events.moved = (command, given) => edit(command, given);
    View.events.section = (index) => chooseSection(View.section === index ? null : index);
    View.events.time = (time, duration) => {
      $("time").max = duration;
      $("time").value = time;
      $("clock").textContent = `${time.toFixed(1)} s`;
    };
  }
  for (const each of document.querySelectorAll("[data-mode]")) each.addEventListener("click", () => setMode(each.dataset.mode));
  function setMode(mode) {
    View?.setMode(mode);
    for (const each of document.querySelectorAll("[data-mode]")) each.setAttribute("aria-pressed", String(each.dataset.mode === mode));
  }
  for (const each of document.querySelectorAll("[data-add]")) each.addEventListener("click", () => setAdding(each.dataset.add));
  for (const each of document.querySelectorAll("[data-view]")) each.addEventListener("click", () => View?.look(each.dataset.view));
  $("select-world").addEventListener("click", () => choose(null));
  $("undo").addEventListener("click", () => request("undo"));
  $("redo").addEventListener("click", () => request("redo"));
  $("save").addEventListener("click", () => request("save"));
  $("save-as").addEventListener("click", async () => {
    const name = await ask("Save as a new file in the same folder", { words: "name", value: "animal2.yaml", act: "Save" });
    if (name) request("save", { name });
  });
  $("keep").addEventListener("click", () => ($("recovered").hidden = kept = true));
  $("discard").addEventListener("click", () => request("discard"));
  addEventListener("keydown", (event) => {
    if ($("dialog").open) return;
    const control = event.ctrlKey || event.metaKey, letter = event.key.toLowerCase();
    const writing = /^(INPUT|SELECT|TEXTAREA)$/.test(event.target.tagName);
    if (control && letter === "s") {
      // A field that is being written makes its edit first.
      event.target.blur?.();
      $("save").click();
    } else if (writing) return;
    else if (control && (letter === "y" || (letter === "z" && event.shiftKey))) $("redo").click();
    else if (control && letter === "z") $("undo").click();
    else if (event.key === "Escape" && adding) setAdding(adding);
    else if (event.key === "Delete" && chosen) $("remove")?.click();
    else if (!control && { w: 1, e: 1, r: 1 }[letter]) setMode({ w: "translate", e: "rotate", r: "scale" }[letter]);
    else return;
    event.preventDefault();
  });
  addEventListener("beforeunload", (event) => {
    if (state?.changed) event.preventDefault();
  });

  // ---- try and train
  async function tryIt(how) {
    const answer = await request("try", { how });
    if (answer.error) return;
    notice("Simulating...");
    for (let waited = 0; ; waited += 1) {
      // The first drive of this version waits for a program.
      if (waited === 30) notice("Compiling...");
      await new Promise((done) => setTimeout(done, 100));
      const found = (await send("/poll", undefined, "GET")).try;
      if (!found) return;
      if (found.state === "running") continue;
      if (found.state === "failed") notice(found.error, true);
      if (found.state === "done") play(found);
      return;
    }
  }
  function play(motion) {
    notice("");
    $("player").hidden = false;
    $("hint").textContent = "";
    $("play").textContent = "Pause";
    View?.play(motion);
  }
  $("try-rest").addEventListener("click", () => tryIt("rest"));
  $("try-drive").addEventListener("click", () => tryIt("drive"));
  $("play").addEventListener("click", () => {
    const going = $("play").textContent === "Pause";
    View?.pause(going);
    $("play").textContent = going ? "Play" : "Pause";
  });
  $("time").addEventListener("input", () => {
    View?.pause(true);
    $("play").textContent = "Play";
    View?.seek(Number($("time").value));
    $("clock").textContent = `${Number($("time").value).toFixed(1)} s`;
  });
  $("close-player").addEventListener("click", () => {
    View?.stop();
    $("player").hidden = true;
    hint();
  });
  $("train").addEventListener("click", async () => {
    if (state.changed) {
      const saved = await request("save");
      if (saved.error) return;
    }
    const usual = state.data.evolution?.generations ?? 50;
    const given = await ask("Train a run in the folder runs, beside the file", { words: "generations", value: String(usual), act: "Train" });
    if (given === null) return;
    // An empty field means the file's number. The server refuses what is no number.
    const count = Number.isFinite(Number(given)) ? Number(given) : given;
    const answer = await request("train", { generations: given.trim() ? count : null });
    if (!answer.error) watch();
  });
  $("stop").addEventListener("click", () => request("stop"));
  $("champion").addEventListener("click", async () => {
    const answer = await request("champion");
    if (answer.motion) play(answer.motion);
  });
  $("live").addEventListener("click", async () => {
    const started = await request("watch");
    if (started.error) return;
    notice("The page of the run starts...");
    const { address, error } = await send("/live_page", "{}");
    if (error) notice(error, true);
    else notice(`The run has a page of its own, in another tab. Its address: ${address}`);
  });
  let watching = false;
  async function watch() {
    if (watching) return;
    watching = true;
    for (;;) {
      const { run } = await send("/poll", undefined, "GET");
      if (!run) break;
      showRun(run);
      if (!run.running) break;
      await new Promise((done) => setTimeout(done, 1000));
    }
    watching = false;
  }
  function showRun(run) {
    $("run").hidden = false;
    $("run-folder").textContent = run.folder;
    $("output").textContent = run.output;
    $("stop").disabled = !run.running || run.stopping;
    $("champion").disabled = run.running || run.code !== 0;
    const best = run.curves.best || [], count = best.length;
    const how = run.running ? (run.stopping ? "stopping after this generation" : "running") : run.code === 0 ? "finished" : run.code === 2 ? `refused: ${run.output.split("\n").pop()}` : "stopped";
    const line = count ? `, ${count} generation${count > 1 ? "s" : ""} done, best fitness ${best[count - 1].toPrecision(4)}` : "";
    $("run-state").textContent = `${how}${line}`;
    const lines = [];
    const all = [...best, ...(run.curves.mean || [])], low = Math.min(...all), high = Math.max(...all);
    for (const [values, color] of [[run.curves.mean || [], "#8fa3ad"], [best, "#d9551a"]]) {
      const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
      line.setAttribute("fill", "none");
      line.setAttribute("stroke", color);
      line.setAttribute("stroke-width", "2");
      line.setAttribute("vector-effect", "non-scaling-stroke");
      line.setAttribute("points", values.map((value, i) => `${(400 * i) / Math.max(values.length - 1, 1)},${114 - (108 * (value - low)) / Math.max(high - low, 1e-9)}`).join(" "));
      lines.push(line);
    }
    $("curve").replaceChildren(...lines);
    $("curve-range").textContent = all.length ? `from ${low.toPrecision(3)} to ${high.toPrecision(3)}` : "";
  }

  setMode("translate");
  request("open").then(() => send("/prepare", "{}")).then(watch);
})();
