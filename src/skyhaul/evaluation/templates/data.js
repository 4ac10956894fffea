// The data of the run: typed arrays out of base64.
"use strict";
const RUN = JSON.parse(document.getElementById("data").textContent);

function unpack(text, Type) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) bytes[i] = raw.charCodeAt(i);
  return new (Type || Float32Array)(bytes.buffer);
}

const FRAMES = { count: RUN.frames.count };
for (const key of ["t", "load", "speed", "vehicles", "tension", "thrust", "clearance", "movers"]) {
  FRAMES[key] = unpack(RUN.frames[key]);
}
for (const key of ["attached", "present"]) FRAMES[key] = unpack(RUN.frames[key], Uint8Array);
RUN.chart_t = unpack(RUN.chart_t);
for (const chart of RUN.charts) {
  for (const line of chart.lines) if (line.y !== undefined) line.y = unpack(line.y);
}
for (const plan of RUN.events.references) plan.points = unpack(plan.points);

const N = RUN.colors.vehicles.length;
const END = RUN.end_s;
const lineColor = (k, dark) =>
  k > 0 ? RUN.colors.vehicles[k - 1] : k < 0 ? (dark ? "#8893a2" : "#98a2b0") : dark ? "#e2b93b" : "#b98900";

// Index of the last frame at or before a time.
function frameAt(t) {
  let low = 0, high = FRAMES.count - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (FRAMES.t[middle] <= t) low = middle; else high = middle - 1;
  }
  return low;
}
