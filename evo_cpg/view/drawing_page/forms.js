// Forms of the panel: shapes, joints and motors. Every field makes an edit of the document.
"use strict";
const Forms = ({ make, button, row, number, numbers, set, edit }) => {
  // Folds that the user has opened stay open when the panel is drawn again.
  const opened = new Set();
  function fold(words, ...rows) {
    return make("details", { open: opened.has(words), ontoggle: (event) => (event.target.open ? opened.add(words) : opened.delete(words)) },
      make("summary", {}, words), ...rows);
  }
  // Options are values, or pairs of a value and its words.
  function select(label, value, options, act) {
    const pairs = options.map((each) => (Array.isArray(each) ? each : [each, each]));
    return make("select", { "aria-label": label, onchange: (event) => act(event.target.value) },
      ...pairs.map(([each, words]) => make("option", { value: each, selected: String(each) === String(value) }, String(words))));
  }
  function tick(label, on, act, words = "") {
    return make("label", {}, make("input", { type: "checkbox", "aria-label": label, checked: Boolean(on), onchange: () => act(!on) }), words);
  }
  // Values with `null` left out.
  const without = (given) => Object.fromEntries(Object.entries(given).filter(([, value]) => value !== null && value !== undefined));
  const replaced = (list, i, value) => list.map((old, k) => (k === i ? value : old));

  // ---- shapes
  const TYPES = ["box", "ellipsoid", "capsule", "cylinder", "sphere", "loft"];
  // Rows of a part's shape (further: null), or of one of its further shapes by its number.
  function shape(name, value, at, { further = null, section = null, chooseSection = null } = {}) {
    const given = value || {}, type = given.type ?? "none", before = further === null ? "" : `shape ${further + 1} `;
    const made = [row("shape", select(`${before}shape`, type, [...new Set([...TYPES, type])], (word) => edit("set_shape", { name, type: word, further })))];
    const put = (key) => (size) => set([...at, key], size);
    if (type === "loft") {
      made.push(row("outline", select(`${before}corners`, given.corners ?? "", [["", "ellipses"], [4, "rectangles"], [6, "hexagons"], [8, "octagons"]], (word) => put("corners")(word ? Number(word) : null))),
        sections(name, given.sections, [...at, "sections"], { before, section, chooseSection, own: further === null }));
    } else if (type === "mesh") {
      if (given.file) {
        made.push(row("file", make("span", { className: "value" }, given.file)));
        const scale = given.scale ?? 1;
        made.push(row("scale", ...(Array.isArray(scale) ? numbers(`${before}scale`, scale, put("scale")) : [number(`${before}scale`, scale, put("scale"))])));
        made.push(row("", tick(`${before}hull`, given.hull, (on) => put("hull")(on || null), "convex hull")));
      } else made.push(row("corners", make("span", { className: "value" }, `${given.vertices?.length ?? 0} in the file`)));
    } else {
      for (const [key, size] of Object.entries(given)) {
        if (key === "type") continue;
        const resize = further === null ? (to) => edit("resize", { name, key, value: to }) : put(key);
        const inputs = Array.isArray(size) ? numbers(`${before}${key}`, size, resize) : [number(`${before}${key}`, size, resize)];
        made.push(row(`${key} (m)`, ...inputs));
      }
    }
    return made;
  }
  function sections(name, list, at, { before, section, chooseSection, own }) {
    const cells = ["", "x", "y", "z", "width", "height", "", ""].map((words) => make("span", { className: "count" }, words));
    list.forEach((each, i) => {
      const put = (key) => (value) => set([...at, i, key], value), label = `${before}section ${i + 1}`;
      const mark = own && chooseSection ? button(String(i + 1), () => chooseSection(section === i ? null : i), { title: `choose section ${i + 1}`, "aria-pressed": String(section === i) }) : make("span", {}, String(i + 1));
      cells.push(mark, ...numbers(label, each.at, put("at")), number(`${label} width`, each.width, put("width")), number(`${label} height`, each.height, put("height")));
      if (own) cells.push(button("+", () => edit("add_section", { name, after: i }), { title: "add a section behind", "aria-label": `add behind section ${i + 1}` }), button("\u00d7", () => edit("remove_section", { name, index: i }), { title: "remove", disabled: list.length <= 2, "aria-label": `remove section ${i + 1}` }));
      else cells.push(make("span"), make("span"));
    });
    return make("div", { className: "sections" }, ...cells);
  }
  function furtherShapes(each, key, materials) {
    return (each.parts || []).flatMap((further, i) => {
      const at = [...key, "parts", i], label = `shape ${i + 1}`;
      const put = (name) => (value) => set([...at, name], value);
      return [
        make("h3", {}, `Further shape ${i + 1}`),
        ...shape(each.name, further.shape, [...at, "shape"], { further: i }),
        row("at (m)", ...numbers(`${label} at`, further.at || [0, 0, 0], put("at"))),
        row("turned (\u00b0)", ...numbers(`${label} rotation`, further.rotation_deg || [0, 0, 0], (value) => put("rotation_deg")(value.some(Boolean) ? value : null))),
        row("material", select(`${label} material`, further.material ?? "", [["", "as the body"], ...materials], (word) => put("material")(word || null))),
        button("Remove this shape", () => edit("remove_shape", { name: each.name, index: i })),
      ];
    });
  }

  // ---- joints
  const NAMES = ["x", "y", "z", "-x", "-y", "-z"];
  const VECTORS = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1], "-x": [-1, 0, 0], "-y": [0, -1, 0], "-z": [0, 0, -1] };
  const LIMITS = [-60, 60];
  // Axes are written in several ways. Here each is {kind, along, at, limits, rest}.
  function read(axis) {
    if (axis && typeof axis === "object" && "slide" in axis) return { kind: "slide", along: axis.slide, limits: axis.limits_m ?? null, rest: axis.rest_m ?? 0, at: null };
    if (axis && typeof axis === "object" && "turn" in axis) return { kind: "turn", along: axis.turn, at: axis.at ?? null };
    return { kind: "turn", along: axis, at: null };
  }
  function written({ kind, along, at, limits, rest }) {
    if (kind === "slide") return { slide: along, ...(limits ? { limits_m: limits } : {}), ...(rest ? { rest_m: rest } : {}) };
    return at ? { turn: along, at } : along;
  }
  function joint(each, key, body) {
    const given = each.joint, name = each.name, ball = given.axes === "ball";
    const axes = ball ? [] : (Array.isArray(given.axes) ? given.axes : []).map(read);
    const put = (part, value) => edit("set_joint", { name, key: part, value });
    const putAxes = (list, kept) => edit("set_axes", { name, axes: list.map(written), ...(kept ? { kept } : {}) });
    const names = axes.map((axis, i) => `axis ${i + 1}`);
    const kind = ball ? "ball" : axes.length ? "axes" : "weld";
    const made = [row("joint", select("joint", kind, [["axes", "turning axes and slides"], ["ball", "ball: turns in any direction"], ["weld", "weld: does not move"]],
      (word) => edit("set_axes", { name, axes: word === "ball" ? "ball" : word === "weld" ? [] : ["z"] })))];
    if (kind === "weld") return made;
    const plain = axes.every((axis) => axis.kind === "turn" && !axis.at && ["x", "y", "z"].includes(axis.along));
    if (kind === "axes") {
      if (plain) {
        const on = axes.map((axis) => axis.along);
        const toggle = (word) => {
          const next = ["x", "y", "z"].filter((other) => (other === word) !== on.includes(other));
          edit("set_axes", { name, axes: next, kept: next.map((other) => (on.includes(other) ? on.indexOf(other) : null)) });
        };
        made.push(row("axes", ...["x", "y", "z"].map((word) => tick(`axis ${word}`, on.includes(word), () => toggle(word), word))));
      }
      const list = axes.flatMap((axis, i) => axisRows(axis, i, axes, putAxes));
      if (axes.length < 6) list.push(button("Add an axis", () => putAxes([...axes, { kind: "slide", along: NAMES.slice(0, 3).find((word) => !axes.some((axis) => axis.kind === "slide" && axis.along === word)) ?? "x" }], [...axes.keys(), null]), { id: "add-axis" }));
      made.push(...(plain ? [fold("Slides, directions and places of axes", ...list)] : list));
    }
    if (ball || axes.some((axis) => axis.kind === "turn")) made.push(...limits(given, put, axes, names, ball));
    made.push(...motors(given, put, axes, names, ball, body));
    made.push(perAxis("stiffness", "N m/rad", given, put, names, ball), perAxis("damping", "N m s/rad", given, put, names, ball));
    made.push(fold("Rest angle, rotor and friction", perAxis("rest_deg", "\u00b0", given, put, names, ball), perAxis("armature", "kg m\u00b2", given, put, names, ball), perAxis("friction_loss", "N m", given, put, names, ball)));
    return made;
  }
  function axisRows(axis, i, axes, putAxes) {
    const change = (values) => putAxes(replaced(axes, i, { ...axis, ...values }));
    const named = NAMES.includes(axis.along), label = `axis ${i + 1}`;
    const vector = () => VECTORS[axis.along] || axis.along;
    const made = [row(label,
      select(`${label} kind`, axis.kind, [["turn", "turns"], ["slide", "slides"]], (kind) => change({ kind, at: null })),
      select(`${label} direction`, named ? axis.along : "other", [...NAMES, "other"], (word) => change({ along: word === "other" ? vector() : word })),
      axes.length > 1 ? button("\u00d7", () => putAxes(axes.filter((_, k) => k !== i), [...axes.keys()].filter((k) => k !== i)), { title: "remove this axis", "aria-label": `remove ${label}` }) : null)];
    if (!named) made.push(row("direction", ...numbers(`${label} vector`, axis.along, (along) => change({ along }))));
    if (axis.kind === "turn") {
      made.push(row("own place", tick(`${label} own place`, axis.at, (on) => change({ at: on ? [0, 0, 0] : null }), axis.at ? "" : "at the joint"),
        ...(axis.at ? numbers(`${label} place`, axis.at, (at) => change({ at })) : [])));
    } else {
      made.push(pair("limits (m)", label, axis.limits, [-0.01, 0.01], (limits) => change({ limits })));
      made.push(row("relaxed at (m)", number(`${label} rest`, axis.rest ?? 0, (rest) => change({ rest: rest || 0 }))));
    }
    return made;
  }
  // Two limits, or none.
  function pair(words, label, value, usual, act) {
    const before = label ? `${label} ` : "";
    return row(words, ...(value ? value.map((limit, i) => number(`${before}${i ? "upper" : "lower"} limit`, limit, (given) => act(replaced(value, i, given)))) : []),
      tick(`${before}no limits`, !value, () => act(value ? null : usual), "none"));
  }
  function limits(given, put, axes, names, ball) {
    const value = given.limits_deg === undefined ? LIMITS : given.limits_deg;
    const own = Array.isArray(value) && value.some((each) => each === null || Array.isArray(each));
    if (ball) {
      return [row("largest angle (\u00b0)", ...(value ? [number("largest angle", value[1], (angle) => put("limits_deg", [0, angle]))] : []),
        tick("no limits", !value, () => put("limits_deg", value ? null : [0, 60]), "none"))];
    }
    const made = own
      ? axes.flatMap((axis, i) => (axis.kind === "slide" ? [] : [pair(`limits ${i + 1} (\u00b0)`, names[i], value[i], LIMITS, (limit) => put("limits_deg", replaced(value, i, limit)))]))
      : [pair("limits (\u00b0)", "", value, LIMITS, (limit) => put("limits_deg", limit))];
    if (axes.length > 1) {
      made.push(row("", tick("limits of each axis", own, (on) => put("limits_deg", on ? axes.map((axis) => (axis.kind === "slide" ? null : value)) : (value.find(Boolean) ?? null)), "for each axis")));
    }
    return made;
  }
  function perAxis(key, unit, given, put, names, ball) {
    const value = given[key] ?? 0, own = Array.isArray(value);
    const act = (next) => put(key, Array.isArray(next) || next ? next : null);
    const words = `${key === "rest_deg" ? "relaxed at" : key.replace("_loss", "")}`;
    return row(words, ...(own ? value.map((each, i) => number(`${key} of ${names[i]}`, each, (to) => act(replaced(value, i, to || 0)), true)) : [number(key, value, (to) => act(to || 0), true)]),
      names.length > 1 && !ball ? tick(`${key} of each axis`, own, (on) => act(on ? names.map(() => value) : value[0]), "each") : null, make("span", { className: "count unit" }, unit));
  }

  // ---- motors and muscles
  const MOTORS = {
    servo: { gain: "gain (N m s/rad)", stiffness: "stiffness (N m/rad)", torque_limit: "largest torque (N m)" },
    torque: { gear: "gear (N m)", torque_limit: "largest torque (N m)" },
    muscle: {
      area: "cross-section (m\u00b2)", arm: "lever arm (m)", fibre_length: "fibre length (m)", stress: "tension (Pa)", bend_deg: "bend (\u00b0)",
      tone: "tone", damping_time: "damping (s)", max_speed: "top speed (1/s)", curvature: "curvature",
    },
  };
  const USUAL = { stress: 200e3, bend_deg: 45, tone: 1, damping_time: 0.02, max_speed: 5, curvature: 0.25, stiffness: 0, gear: 1 };
  const REQUIRED = ["gain", "area", "arm", "fibre_length"];
  const kindOf = (motor) => (motor ? (motor.type ?? "servo") : "none");
  function fresh(kind, body) {
    const wide = Number((Math.min(...(body?.half ?? [0.02])) || 0.02).toPrecision(2));
    if (kind === "servo") return { gain: 1 };
    if (kind === "torque") return { type: "torque", gear: 1 };
    return kind === "muscle" ? { type: "muscle", area: Number((wide * wide).toPrecision(2)), arm: wide, fibre_length: 4 * wide } : null;
  }
  function motorRows(motor, label, words, act, body, turns) {
    const kind = kindOf(motor), before = label ? `${label} ` : "";
    const made = [row(words, select(`${before}motor`, kind, [["none", "none: it is passive"], ["servo", "servo"], ["torque", "torque motor"], ...(turns || kind === "muscle" ? [["muscle", "muscles"]] : [])], (next) => act(fresh(next, body))))];
    for (const [key, name] of Object.entries(MOTORS[kind] || {})) {
      made.push(row(name, number(`${before}${key}`, motor[key] ?? USUAL[key], (value) => act(without({ ...motor, [key]: value })), !REQUIRED.includes(key))));
    }
    if (kind === "muscle") made.push(row("Hill's law", tick(`${before}hill`, motor.hill ?? true, (on) => act(without({ ...motor, hill: on ? null : false })))));
    return made;
  }
  function motors(given, put, axes, names, ball, body) {
    const value = given.actuator ?? null, own = Array.isArray(value);
    const made = own
      ? value.flatMap((motor, i) => motorRows(motor, `axis ${i + 1}`, `motor ${i + 1}`, (next) => put("actuator", replaced(value, i, next)), body, !ball && axes[i]?.kind === "turn"))
      : motorRows(value, "", "motor", (next) => put("actuator", next), body, !ball && axes.every((axis) => axis.kind === "turn"));
    if (axes.length > 1) {
      made.push(row("", tick("motor of each axis", own, (on) => put("actuator", on ? axes.map(() => value) : (value.find(Boolean) ?? null)), "for each axis")));
    }
    return made;
  }
  return { shape, furtherShapes, joint, select };
};
