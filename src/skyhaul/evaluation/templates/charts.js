// Charts over time, one plotly graph each, with linked time axes and a common cursor.
"use strict";
const WHOLE = [-0.006 * END, 1.006 * END];
const Charts = {
  graphs: [],
  hidden: new Set(),

  make(seek) {
    const parent = document.getElementById("charts");
    const charts = RUN.events.triggers.length ? [this.triggers(), ...RUN.charts] : RUN.charts;
    for (const chart of charts) {
      const card = document.createElement("div");
      card.className = chart.wide ? "chart wide" : "chart";
      card.innerHTML = `<h3>${chart.title}${chart.unit ? ` <span>[${chart.unit}]</span>` : ""}</h3><div class="plot"></div>`;
      parent.append(card);
      const plot = card.querySelector(".plot");
      const cursor = document.createElement("div");
      cursor.className = "cursor";
      plot.style.height = `${chart.height || 190}px`;
      this.graphs.push({ chart, plot, cursor });
    }
    for (const { chart, plot, cursor } of this.graphs) {
      Plotly.newPlot(plot, this.traces(chart), this.layout(chart), {
        displaylogo: false, responsive: true, displayModeBar: false, doubleClick: false });
      plot.append(cursor);
      plot.on("plotly_relayout", (change) => this.link(plot, change));
      plot.on("plotly_click", (e) => seek(e.points[0].x));
      plot.on("plotly_doubleclick", () => this.range(null));
    }
  },

  // What fired, one row for each cause.
  triggers() {
    const causes = [...new Set(RUN.events.triggers.map((x) => x.cause))].reverse();
    return {
      title: "Triggers", unit: "", bounds: [], wide: true, names: true,
      height: 52 + 20 * causes.length, left: 150, lines: [{
        x: RUN.events.triggers.map((x) => x.t_s), points: RUN.events.triggers.map((x) => words(x.cause)),
        text: RUN.events.triggers.map((x) => x.detail), name: "trigger", color: 0 }],
    };
  },

  dark: () => document.documentElement.dataset.theme === "dark",

  traces(chart) {
    const dark = this.dark();
    return chart.lines.map((line) => {
      const visible = !(line.color > 0 && this.hidden.has(line.color - 1));
      if (line.points) return {
        x: line.x, y: line.points, text: line.text, mode: "markers", type: "scatter",
        marker: { size: 5, opacity: 0.75, color: dark ? "#6ea5f5" : "#3478de" }, visible,
        hovertemplate: (chart.unit ? "%{text}<br>%{y:.2f} " + chart.unit : "%{x:.2f} s<br>%{text}")
          + "<extra></extra>" };
      return {
        x: RUN.chart_t, y: line.y, name: line.name, mode: "lines", type: "scatter", visible,
        connectgaps: false,
        line: { width: line.dash ? 1.3 : 1.5, color: lineColor(line.color, dark),
          dash: line.dash ? "dot" : "solid" },
        hovertemplate: "%{y:.3f}<extra>" + line.name + "</extra>" };
    });
  },

  layout(chart) {
    const dark = this.dark(), ink = dark ? "#a0abba" : "#5d6878", grid = dark ? "#2a323e" : "#e9ecf1";
    const shade = ["rgba(120,140,170,0.10)", "rgba(120,140,170,0.02)"];
    const shapes = RUN.phases.map((phase, i) => ({
      type: "rect", xref: "x", yref: "paper", x0: phase.t0, x1: phase.t1, y0: 0, y1: 1,
      fillcolor: shade[i % 2], line: { width: 0 }, layer: "below" }));
    const notes = chart.names ? RUN.phases.filter((p) => p.t1 - p.t0 > 0.03 * END).map((p) => ({
      x: (p.t0 + p.t1) / 2, y: 1, yref: "paper", yanchor: "bottom", text: p.name, showarrow: false,
      font: { size: 10.5, color: ink } })) : [];
    for (const bound of chart.bounds) {
      shapes.push({ type: "line", xref: "paper", x0: 0, x1: 1, y0: bound.y, y1: bound.y,
        line: { width: 1, dash: "dash", color: dark ? "#f2827b" : "#c2362f" } });
      notes.push({ xref: "paper", x: 0.004, xanchor: "left", y: bound.y, yanchor: "bottom",
        text: bound.name, showarrow: false, font: { size: 10, color: dark ? "#f2827b" : "#c2362f" } });
    }
    return {
      margin: { l: chart.left || 46, r: 10, t: chart.names ? 18 : 6, b: 26 },
      height: chart.height || 190, shapes, annotations: notes,
      paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false,
      font: { family: "Inter, 'Segoe UI', Roboto, sans-serif", size: 11, color: ink },
      hovermode: chart.lines[0].points ? "closest" : "x unified", dragmode: "zoom",
      hoverlabel: { bgcolor: dark ? "#232b36" : "#ffffff", bordercolor: grid,
        font: { size: 11, color: dark ? "#e6eaf0" : "#1b2330" } },
      xaxis: { range: this.window || WHOLE, gridcolor: grid, zeroline: false, ticksuffix: " s",
        hoverformat: ".2f" },
      yaxis: { gridcolor: grid, zeroline: false, fixedrange: true, type: chart.log ? "log" : "-",
        dtick: chart.log ? 1 : undefined, rangemode: chart.title === "Thrust" ? "normal" : "tozero" },
    };
  },

  link(from, change) {
    if (this.linking) return;
    if (change["xaxis.autorange"]) this.range(null);
    else if (change["xaxis.range[0]"] !== undefined)
      this.range([change["xaxis.range[0]"], change["xaxis.range[1]"]], from);
  },

  range(window_, from) {
    this.window = window_;
    this.linking = true;
    const jobs = this.graphs.filter((g) => g.plot !== from)
      .map((g) => Plotly.relayout(g.plot, { "xaxis.range": window_ || WHOLE }));
    Promise.all(jobs).then(() => { this.linking = false; this.cursor(this.t); });
  },

  redraw() {
    for (const g of this.graphs) {
      Plotly.react(g.plot, this.traces(g.chart), this.layout(g.chart));
      g.plot.append(g.cursor);
    }
    this.cursor(this.t);
  },

  // Move the cursor of every chart; no redraw.
  cursor(t) {
    this.t = t;
    for (const { plot, cursor } of this.graphs) {
      const axis = plot._fullLayout && plot._fullLayout.xaxis;
      if (!axis) continue;
      const x = axis.l2p(t);
      cursor.hidden = x < 0 || x > axis._length;
      cursor.style.transform = `translateX(${axis._offset + x}px)`;
    }
  },
};
