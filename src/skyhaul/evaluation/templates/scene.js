// The flight in 3-D: room, obstacles, team, planned and flown paths.
"use strict";
const THEMES = {
  light: { sky: [0.933, 0.945, 0.961], floor: [0.872, 0.89, 0.914], grid: [0.7, 0.735, 0.78, 0.55],
    edge: [0.6, 0.64, 0.7, 0.8], shadow: [0.76, 0.785, 0.82, 1], cable: [0.2, 0.23, 0.28, 1],
    body: [0.22, 0.25, 0.3], label: "#475163" },
  dark: { sky: [0.086, 0.106, 0.137], floor: [0.12, 0.145, 0.185], grid: [0.26, 0.3, 0.37, 0.6],
    edge: [0.33, 0.38, 0.46, 0.8], shadow: [0.075, 0.092, 0.12, 1], cable: [0.85, 0.88, 0.92, 1],
    body: [0.62, 0.66, 0.72], label: "#b8c2d0" },
};
const GOAL = [0.09, 0.62, 0.43], PLAN = [0.2, 0.47, 0.87], OLD_PLAN = [0.55, 0.6, 0.68];

class Scene {
  constructor(canvas, labels) {
    this.labels = labels;
    this.r = new Renderer(canvas);
    this.show = { follow: false, plan: true, earlier: false, trail: true, labels: true };
    this.makeMeshes();
    this.trail = [];
    for (let k = 0; k < FRAMES.count; k++) this.trail.push(this.loadAt(k));
    this.fit();
    this.listen(canvas);
  }

  loadAt(k) { return Array.from(FRAMES.load.subarray(7 * k, 7 * k + 3)); }

  makeMeshes() {
    const r = this.r;
    this.box = r.upload(Mesh.box());
    this.cylinder = r.upload(Mesh.cylinder());
    this.ball = r.upload(Mesh.capsule(1, 0, 14, 40));
    const solid = (o) => ({
      ...o,
      mesh: o.kind === "box" ? this.box : o.kind === "sphere" ? this.ball :
        r.upload(Mesh.capsule(o.size[0], o.size[1])),
      scale: o.kind === "box" ? o.size.map((x) => 2 * x) : o.kind === "sphere" ?
        [o.size[0], o.size[0], o.size[0]] : [1, 1, 1],
    });
    this.still = RUN.scene.still.map(solid);
    this.movers = RUN.scene.movers.map(solid);
  }

  // Frame the whole flight.
  fit() {
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    const points = this.trail.slice();
    if (RUN.scene.goal) points.push(RUN.scene.goal);
    for (const o of RUN.scene.still) points.push(o.p);
    for (const p of points)
      for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], p[k] - 0.5);
        high[k] = Math.max(high[k], p[k] + (k === 2 ? 1.3 : 0.5));
      }
    low[2] = Math.max(0, Math.min(low[2], 0.2 * high[2]));
    this.target = points.length ? mix(low, high, 0.5) : [0, 0, 1];
    this.distance = points.length ? 1.25 * Math.max(norm(sub(high, low)), 3) : 10;
    this.azimuth = -0.95;
    this.elevation = 0.36;
    this.dirty = true;
  }

  listen(canvas) {
    let held = null;
    const fingers = new Map();
    canvas.addEventListener("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("dblclick", () => this.fit());
    canvas.addEventListener("pointerdown", (e) => {
      canvas.setPointerCapture(e.pointerId);
      fingers.set(e.pointerId, [e.clientX, e.clientY]);
      held = { x: e.clientX, y: e.clientY, pan: e.shiftKey || e.button !== 0 };
    });
    const up = (e) => { fingers.delete(e.pointerId); held = null; };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointermove", (e) => {
      if (!held) return;
      const gap = () => {
        const [a, b] = [...fingers.values()];
        return Math.hypot(a[0] - b[0], a[1] - b[1]);
      };
      if (fingers.size === 2) {
        const before = gap();
        fingers.set(e.pointerId, [e.clientX, e.clientY]);
        this.zoom(before / Math.max(gap(), 1));
        return;
      }
      const dx = e.clientX - held.x, dy = e.clientY - held.y;
      held.x = e.clientX;
      held.y = e.clientY;
      if (held.pan) this.pan(dx, dy);
      else {
        this.azimuth -= 0.006 * dx;
        this.elevation = Math.min(1.55, Math.max(-0.2, this.elevation + 0.006 * dy));
      }
      this.dirty = true;
    });
    canvas.addEventListener("wheel", (e) => {
      e.preventDefault();
      this.zoom(Math.exp(0.0012 * e.deltaY));
    }, { passive: false });
  }

  zoom(factor) {
    this.distance = Math.min(400, Math.max(0.6, this.distance * factor));
    this.dirty = true;
  }

  pan(dx, dy) {
    const s = (0.83 * this.distance) / this.r.canvas.clientHeight;
    const c = Math.cos(this.azimuth), n = Math.sin(this.azimuth), e = Math.sin(this.elevation);
    const right = [-n, c, 0], upward = [-c * e, -n * e, Math.cos(this.elevation)];
    this.target = add(this.target, add(scale(right, -dx * s), scale(upward, dy * s)));
  }

  camera(follow) {
    const target = this.show.follow ? add(follow, [0, 0, 0.5]) : this.target;
    const distance = this.show.follow ? Math.min(this.distance, 7) : this.distance;
    const c = Math.cos(this.elevation);
    const back = [c * Math.cos(this.azimuth), c * Math.sin(this.azimuth), Math.sin(this.elevation)];
    const eye = add(target, scale(back, distance));
    eye[2] = Math.max(eye[2], 0.05);
    const aspect = this.r.canvas.clientWidth / Math.max(1, this.r.canvas.clientHeight);
    const near = Math.max(0.02, distance / 200);
    const view = multiply(perspective(0.79, aspect, near, 40 * distance + 60), lookAt(eye, target));
    return { eye, view, distance };
  }

  // State of everything at a time, between frames.
  poses(t) {
    const k = frameAt(t), j = Math.min(k + 1, FRAMES.count - 1);
    const span = FRAMES.t[j] - FRAMES.t[k];
    const s = span > 0 ? Math.min(1, Math.max(0, (t - FRAMES.t[k]) / span)) : 0;
    const pose = (data, stride, i) => {
      const a = Array.from(data.subarray(stride * k + 7 * i, stride * k + 7 * i + 7));
      const b = Array.from(data.subarray(stride * j + 7 * i, stride * j + 7 * i + 7));
      const q = blend(a.slice(3), b.slice(3), s);
      return { p: mix(a.slice(0, 3), b.slice(0, 3), s), R: rotation(q) };
    };
    const m = this.movers.length;
    const movers = this.movers.map((o, i) => {
      const at = (f) => Array.from(FRAMES.movers.subarray(3 * (m * f + i), 3 * (m * f + i) + 3));
      return { p: mix(at(k), at(j), s), present: FRAMES.present[m * k + i] > 0 };
    });
    const vehicles = [];
    for (let i = 0; i < N; i++) {
      vehicles.push({ ...pose(FRAMES.vehicles, 7 * N, i), attached: FRAMES.attached[N * k + i] > 0 });
    }
    return { k, load: pose(FRAMES.load, 7, 0), vehicles, movers };
  }

  draw(t, dark) {
    if (!FRAMES.count) return;
    const theme = dark ? THEMES.dark : THEMES.light;
    const now = this.poses(t);
    const { eye, view, distance } = this.camera(now.load.p);
    const r = this.r;
    r.begin(view, eye, theme.sky, Math.max(60, 6 * distance));
    this.drawRoom(theme);
    const team = this.teamItems(now, theme);
    const still = this.still.map((o) => ({
      mesh: o.mesh, world: model(o.R, o.p, o.scale), tint: [...rgb(RUN.colors.still), 1] }));
    const movers = this.movers.flatMap((o, i) => now.movers[i].present ? [{
      mesh: o.mesh, world: model(o.R, now.movers[i].p, o.scale), tint: [...rgb(RUN.colors.mover), 1],
    }] : []);
    const solids = [...still, ...movers, ...team.solid];
    r.drawMeshes(solids.map((x) => ({ ...x, tint: theme.shadow })), true);
    r.drawMeshes(solids);
    r.drawLines(r.segments([...team.lines, ...this.pathLines(now, t)]));
    const goal = RUN.scene.goal;
    const glass = team.glass;
    if (goal) {
      const g = RUN.scene.goal_radius;
      glass.push({ mesh: this.ball, world: model(EYE, goal, [g, g, g]), tint: [...GOAL, 0.22] });
    }
    r.drawMeshes(glass);
    this.drawLabels(view, now, theme);
  }

  drawRoom(theme) {
    const [low, high] = RUN.scene.room, r = this.r;
    const size = sub(high, low), lines = [];
    r.drawMeshes([{ mesh: this.box, tint: [...theme.floor, 1],
      world: model(EYE, [low[0] + size[0] / 2, low[1] + size[1] / 2, low[2] - 0.03],
        [size[0], size[1], 0.05]) }]);
    const step = Math.max(size[0], size[1]) > 40 ? 10 : 1, z = low[2] + 0.002;
    for (let x = Math.ceil(low[0] / step) * step; x <= high[0]; x += step)
      lines.push([[x, low[1], z], [x, high[1], z], theme.grid, 1]);
    for (let y = Math.ceil(low[1] / step) * step; y <= high[1]; y += step)
      lines.push([[low[0], y, z], [high[0], y, z], theme.grid, 1]);
    const corner = (i) => [i & 1 ? high[0] : low[0], i & 2 ? high[1] : low[1], i & 4 ? high[2] : low[2]];
    for (let i = 0; i < 8; i++)
      for (const bit of [1, 2, 4]) if (!(i & bit)) lines.push([corner(i), corner(i | bit), theme.edge, 1.2]);
    r.drawLines(r.segments(lines));
  }

  teamItems(now, theme) {
    const { payload, vehicle, hooks } = RUN.scene;
    const solid = [], glass = [], lines = [];
    const rigid = payload.kind === "rigid";
    solid.push({ mesh: rigid ? this.box : this.ball, tint: [...rgb(RUN.colors.load), 1],
      world: model(now.load.R, now.load.p, payload.size.map((x) => (rigid ? x : x / 2))) });
    now.vehicles.forEach((v, i) => {
      const tint = rgb(RUN.colors.vehicles[i]), a = vehicle.arm / Math.SQRT2;
      const part = (offset, size, color, mesh) =>
        ({ mesh, tint: color, world: model(v.R, add(v.p, rotate(v.R, offset)), size) });
      const b = 0.42 * vehicle.arm;
      solid.push(part([0, 0, 0], [b, b, 0.9 * vehicle.half_height], [...tint, 1], this.cylinder));
      for (const [x, y] of [[1, 1], [1, -1], [-1, -1], [-1, 1]]) {
        const hub = [a * x, a * y, 0.5 * vehicle.half_height];
        lines.push([v.p, add(v.p, rotate(v.R, hub)), [...theme.body, 1], 2.4]);
        const d = vehicle.rotor;
        solid.push(part(hub, [0.18 * d, 0.18 * d, 0.02], [...theme.body, 1], this.cylinder));
        glass.push(part(add(hub, [0, 0, 0.015]), [d, d, 0.004], [...tint, x > 0 ? 0.55 : 0.3],
          this.cylinder));
      }
      if (v.attached) {
        const hook = add(now.load.p, rotate(now.load.R, hooks[i]));
        lines.push([v.p, hook, theme.cable, 1.6]);
      }
    });
    return { solid, glass, lines };
  }

  pathLines(now, t) {
    const lines = [], plans = RUN.events.references;
    const path = (plan, tint, width) => {
      for (let i = 0; i + 1 < plan.count; i++)
        lines.push([Array.from(plan.points.subarray(3 * i, 3 * i + 3)),
          Array.from(plan.points.subarray(3 * i + 3, 3 * i + 6)), tint, width]);
    };
    let last = -1;
    plans.forEach((plan, i) => { if (plan.t_s <= t + 1e-6) last = i; });
    if (this.show.earlier)
      for (let i = 0; i < last; i++) path(plans[i], [...OLD_PLAN, 0.35], 1.3);
    if (this.show.plan && last >= 0) path(plans[last], [...PLAN, 0.95], 2.6);
    if (this.show.trail) {
      const tint = [...rgb(RUN.colors.load), 0.95];
      const step = Math.max(1, Math.floor(now.k / 1500));
      for (let k = step; k <= now.k; k += step) lines.push([this.trail[k - step], this.trail[k], tint, 3]);
    }
    return lines;
  }

  drawLabels(view, now, theme) {
    const canvas = this.labels, { width, height, ratio } = this.r;
    canvas.width = width;
    canvas.height = height;
    if (!this.show.labels) return;
    const pen = canvas.getContext("2d");
    pen.scale(ratio, ratio);
    pen.font = "500 11px Inter, 'Segoe UI', Roboto, sans-serif";
    pen.textAlign = "center";
    pen.fillStyle = theme.label;
    const say = (text, p) => {
      const [x, y, depth] = project(view, p, width / ratio, height / ratio);
      if (depth > 0.05) pen.fillText(text, x, y);
    };
    if (RUN.scene.goal) say("goal", add(RUN.scene.goal, [0, 0, RUN.scene.goal_radius + 0.12]));
    this.movers.forEach((o, i) => {
      const top = o.kind === "box" ? o.size[2] : o.size[0] + Math.abs(o.R[8]) * o.size[1];
      if (now.movers[i].present) say(o.name, add(now.movers[i].p, [0, 0, top + 0.1]));
    });
    now.vehicles.forEach((v, i) => say(String(i), add(v.p, [0, 0, 0.14])));
  }
}
