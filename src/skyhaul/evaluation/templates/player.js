// The page: header, time, side panel, events, tables.
"use strict";
const $ = (id) => document.getElementById(id);
const make = (tag, attributes, ...inner) => {
  const node = Object.assign(document.createElement(tag), attributes);
  node.append(...inner);
  return node;
};
const words = (text) => text.replaceAll("_", " ");

const Player = {
  t: 0, playing: false, speed: 1, scene: null,

  start() {
    const stored = (() => { try { return localStorage.getItem("skyhaul-theme"); } catch { return null; } })();
    const dark = stored ? stored === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    document.documentElement.dataset.theme = dark ? "dark" : "light";
    this.header();
    this.cards();
    this.legend();
    try { this.scene = new Scene($("gl"), $("labels")); } catch { $("nogl").hidden = false; }
    this.tools();
    this.events();
    this.side();
    Charts.make((t) => this.seek(t));
    this.controls();
    this.seek(Number(new URLSearchParams(location.hash.slice(1)).get("t")) || 0);
    let last = performance.now();
    const step = (now) => {
      const passed = (now - last) / 1000;
      last = now;
      if (this.playing) {
        this.seek(this.t + passed * this.speed);
        if (this.t >= END) this.play(false);
      } else if (this.scene && this.scene.dirty) this.draw();
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
    addEventListener("resize", () => { this.timeline(); this.draw(); Charts.cursor(this.t); });
  },

  get dark() { return document.documentElement.dataset.theme === "dark"; },

  draw() {
    if (!this.scene) return;
    this.scene.dirty = false;
    this.scene.draw(this.t, this.dark);
  },

  seek(t) {
    this.t = Math.min(END, Math.max(0, t));
    $("slider").value = this.t / (END || 1);
    this.draw();
    this.now();
    this.timeline();
    Charts.cursor(this.t);
  },

  play(on) {
    if (on && this.t >= END - 1e-3) this.t = 0;
    this.playing = on;
    $("play").textContent = on ? "❚❚" : "▶";
  },

  header() {
    $("title").textContent = RUN.scenario;
    $("subtitle").textContent = `${RUN.description ? RUN.description.replace(/\.$/, "") + " · " : ""}seed ${RUN.origin.seed}`
      + ` · ${N} vehicles · skyhaul ${RUN.origin.versions.skyhaul}`;
    $("badge").textContent = RUN.done ? "mission done" : "mission failed";
    $("badge").classList.add(RUN.done ? "good" : "bad");
    $("outcome").textContent = RUN.outcome;
    for (const tile of RUN.tiles) {
      $("tiles").append(make("div", { className: "tile" }, make("b", { textContent: tile.value }),
        make("span", { className: "unit", textContent: tile.unit }),
        make("span", { className: "label", textContent: tile.label })));
    }
    $("theme").onclick = () => {
      const next = this.dark ? "light" : "dark";
      document.documentElement.dataset.theme = next;
      try { localStorage.setItem("skyhaul-theme", next); } catch { /* private window */ }
      this.draw();
      this.timeline();
      Charts.redraw();
    };
  },

  cards() {
    for (const group of RUN.table) {
      const rows = group.lines.map((line) => {
        const mark = line.good === null ? "" : (line.good ? "✓ " : "✗ ") + line.rule;
        const style = line.good === null ? "r" : line.good ? "r good-text" : "r bad-text";
        return make("tr", {}, make("td", { textContent: line.label }),
          make("td", { className: "v", textContent: line.value }),
          make("td", { className: "u", textContent: line.unit }),
          make("td", { className: style, textContent: mark }));
      });
      $("cards").append(make("div", { className: "card" }, make("h3", { textContent: group.title }),
        make("table", {}, make("tbody", {}, ...rows))));
    }
    const { seed, commit, machine, versions } = RUN.origin;
    const all = Object.entries(versions).map(([k, v]) => `${k} ${v}`).join(" · ");
    for (const [k, v] of Object.entries({ seed, commit, machine, versions: all })) {
      $("origin").append(make("dt", { textContent: k }), make("dd", { textContent: v }));
    }
  },

  legend() {
    const parent = $("legend");
    for (let i = 0; i < N; i++) {
      const dot = make("span", { className: "dot" });
      dot.style.background = RUN.colors.vehicles[i];
      const chip = make("button", { className: "chip", title: "Show or hide in the charts" }, dot,
        `vehicle ${i}`);
      chip.setAttribute("aria-pressed", "true");
      chip.onclick = () => {
        const on = Charts.hidden.delete(i);
        if (!on) Charts.hidden.add(i);
        chip.setAttribute("aria-pressed", String(on));
        Charts.redraw();
      };
      parent.append(chip);
    }
    parent.append(make("span", { className: "gap" }),
      "drag in a chart: zoom all · double click: all of the flight · click: go to that time");
  },

  tools() {
    if (!this.scene) return;
    const names = { follow: "follow", trail: "flown", plan: "plan in force",
      earlier: "earlier plans", labels: "labels" };
    for (const [key, name] of Object.entries(names)) {
      const chip = make("button", { className: "chip", textContent: name });
      chip.setAttribute("aria-pressed", String(this.scene.show[key]));
      chip.onclick = () => {
        this.scene.show[key] = !this.scene.show[key];
        chip.setAttribute("aria-pressed", String(this.scene.show[key]));
        this.draw();
      };
      $("tools").append(chip);
    }
  },

  events() {
    const e = RUN.events;
    this.list = [
      ...RUN.phases.map((x) => ({ t: x.t0, head: x.name, text: "phase", kind: "stage-begin" })),
      ...e.triggers.map((x) => ({ t: x.t_s, head: words(x.cause), text: x.detail, kind: "trigger" })),
      ...e.replans.map((x) => ({ t: x.t_s, head: x.accepted ? "new plan" : "plan not taken",
        text: `${words(x.cause)}: ${x.status}`, kind: x.accepted ? "replan" : "refused" })),
      ...e.contacts.map((x) => ({ t: x.t_s, head: `${x.body_a} touches ${x.body_b}`,
        text: x.lost ? "of a lost vehicle" : "contact", kind: "contact" })),
    ].sort((a, b) => a.t - b.t);
    for (const item of this.list) {
      item.node = make("li", { className: item.kind }, make("time", { textContent: item.t.toFixed(2) }),
        make("div", {}, item.head, make("small", { textContent: item.text })));
      item.node.onclick = () => this.seek(item.t);
      $("events").append(item.node);
    }
    this.list.forEach((x) => x.node.classList.add("future"));
    this.shown = -1;
  },

  side() {
    this.fields = {};
    for (const name of ["speed", "height", "clearance"]) {
      this.fields[name] = make("dd", {});
      $("now-list").append(make("dt", { textContent: name }), this.fields[name]);
    }
    $("bars").append(make("div", { className: "bar head" }, make("span", {}), make("span", {}),
      make("span", { className: "v", textContent: "tension" }),
      make("span", { className: "v", textContent: "thrust" })));
    this.bars = RUN.colors.vehicles.map((color) => {
      const dot = make("span", { className: "dot" }), fill = make("b", {});
      dot.style.background = fill.style.background = color;
      const tension = make("span", { className: "v" }), thrust = make("span", { className: "v" });
      $("bars").append(make("div", { className: "bar" }, dot, make("i", {}, fill), tension, thrust));
      return { fill, tension, thrust };
    });
    this.most = Math.max(0.1, ...Array.from(FRAMES.tension).filter(Number.isFinite));
  },

  now() {
    if (!FRAMES.count) return;
    const k = frameAt(this.t), show = (x, unit, n = 2) => Number.isFinite(x) ? `${x.toFixed(n)} ${unit}` : "-";
    const phase = RUN.phases.filter((x) => x.t0 <= this.t + 1e-9).at(-1);
    $("now-t").textContent = this.t.toFixed(2);
    $("now-phase").textContent = phase ? phase.name : "";
    this.fields.speed.textContent = show(FRAMES.speed[k], "m/s");
    this.fields.height.textContent = show(FRAMES.load[7 * k + 2], "m");
    this.fields.clearance.textContent = show(FRAMES.clearance[k], "m");
    this.bars.forEach((bar, i) => {
      const tension = FRAMES.tension[N * k + i];
      bar.fill.style.width = `${Math.min(100, (100 * tension) / this.most)}%`;
      bar.tension.textContent = FRAMES.attached[N * k + i] ? show(tension, "N") : "released";
      bar.thrust.textContent = show(FRAMES.thrust[N * k + i], "N");
    });
    let last = -1;
    this.list.forEach((x, i) => { if (x.t <= this.t + 1e-6) last = i; });
    if (last === this.shown) return;
    const from = Math.max(0, Math.min(this.shown, last)), to = Math.max(this.shown, last);
    for (let i = from; i <= to; i++) {
      this.list[i].node.classList.toggle("future", i > last);
      this.list[i].node.classList.toggle("last", i === last);
    }
    this.shown = last;
    const box = $("events"), node = last >= 0 ? this.list[last].node : null;
    box.scrollTop = node ? node.offsetTop - box.offsetTop - box.clientHeight / 2 : 0;
  },

  timeline() {
    const canvas = $("timeline"), ratio = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    const pen = canvas.getContext("2d"), x = (t) => 8 + ((width - 16) * t) / (END || 1);
    pen.scale(ratio, ratio);
    const dark = this.dark;
    pen.font = "500 10.5px Inter, 'Segoe UI', Roboto, sans-serif";
    RUN.phases.forEach((phase, i) => {
      pen.fillStyle = dark ? (i % 2 ? "#252d38" : "#2d3644") : (i % 2 ? "#e9edf2" : "#dde3ea");
      pen.fillRect(x(phase.t0), 20, x(phase.t1) - x(phase.t0), 8);
      pen.fillStyle = dark ? "#a0abba" : "#5d6878";
      const wide = pen.measureText(phase.name).width;
      if (x(phase.t1) - x(phase.t0) > wide + 6) pen.fillText(phase.name, x(phase.t0) + 2, 14);
    });
    pen.fillStyle = dark ? "#6ea5f5" : "#3478de";
    pen.fillRect(x(0), 20, x(this.t) - x(0), 8);
    const colors = { trigger: "#8893a2", replan: dark ? "#6ea5f5" : "#3478de", refused: "#e07b22", contact: "#d23b33" };
    for (const item of this.list) {
      if (item.kind === "stage-begin") continue;
      pen.fillStyle = colors[item.kind];
      const tall = item.kind === "trigger" ? 6 : 10;
      pen.fillRect(x(item.t) - 0.75, 30, 1.5, tall);
    }
    pen.beginPath();
    pen.arc(x(this.t), 24, 7, 0, 7);
    pen.fillStyle = "#ffffff";
    pen.fill();
    pen.lineWidth = 2;
    pen.strokeStyle = dark ? "#6ea5f5" : "#3478de";
    pen.stroke();
  },

  controls() {
    $("play").onclick = () => this.play(!this.playing);
    $("speed").onchange = (e) => { this.speed = Number(e.target.value); };
    const track = $("track"), tip = $("tip");
    const time = (e) => {
      const box = track.getBoundingClientRect();
      return (END * Math.min(1, Math.max(0, (e.clientX - box.left - 8) / (box.width - 16))));
    };
    let held = false;
    track.addEventListener("pointerdown", (e) => {
      held = true;
      track.setPointerCapture(e.pointerId);
      this.seek(time(e));
      e.preventDefault();
    });
    track.addEventListener("pointerup", () => { held = false; });
    track.addEventListener("pointermove", (e) => {
      const t = time(e);
      if (held) this.seek(t);
      const reach = (END * 5) / track.clientWidth;
      const near = this.list.filter((x) => Math.abs(x.t - t) < reach).slice(0, 4);
      tip.textContent = [`${t.toFixed(2)} s`, ...near.map((x) => `${x.head}: ${x.text}`)].join("\n");
      const box = track.getBoundingClientRect();
      tip.style.left = `${Math.min(box.width - 90, Math.max(90, e.clientX - box.left))}px`;
      tip.hidden = false;
    });
    track.addEventListener("pointerleave", () => { tip.hidden = true; });
    $("slider").oninput = (e) => this.seek(END * Number(e.target.value));
    addEventListener("keydown", (e) => {
      if (e.target.tagName === "SELECT") return;
      if (e.key === " ") { e.preventDefault(); this.play(!this.playing); }
      if (e.key === "ArrowRight" && e.target.id !== "slider") this.seek(this.t + 0.1);
      if (e.key === "ArrowLeft" && e.target.id !== "slider") this.seek(this.t - 0.1);
    });
  },
};
Player.start();
