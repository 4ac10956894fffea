// Triangle meshes: interleaved position and normal.
"use strict";
const Mesh = {
  // Box with edges of length 1 about the origin.
  box() {
    const out = [];
    for (let axis = 0; axis < 3; axis++)
      for (const sign of [-1, 1]) {
        const n = [0, 0, 0];
        n[axis] = sign;
        const u = (axis + 1) % 3, v = (axis + 2) % 3;
        const corner = (a, b) => {
          const p = [0, 0, 0];
          p[axis] = sign / 2;
          p[u] = a / 2;
          p[v] = b / 2;
          return p;
        };
        const q = [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)];
        for (const k of sign > 0 ? [0, 1, 2, 0, 2, 3] : [0, 2, 1, 0, 3, 2]) out.push(...q[k], ...n);
      }
    return out;
  },

  // Surface of revolution about z of a profile of [radius, z, normal radius, normal z].
  turned(profile, sides) {
    const out = [];
    const at = (row, k) => {
      const a = (2 * Math.PI * k) / sides, c = Math.cos(a), s = Math.sin(a);
      return [row[0] * c, row[0] * s, row[1], row[2] * c, row[2] * s, row[3]];
    };
    for (let i = 0; i + 1 < profile.length; i++)
      for (let k = 0; k < sides; k++) {
        const a = at(profile[i], k), b = at(profile[i], k + 1);
        const c = at(profile[i + 1], k + 1), d = at(profile[i + 1], k);
        out.push(...a, ...b, ...c, ...a, ...c, ...d);
      }
    return out;
  },

  // Ball of radius r, its halves drawn apart by 2 h along z.
  capsule(r, h, rows = 10, sides = 32) {
    const profile = [];
    for (const [from, shift] of [[-1, -h], [0, h]])
      for (let i = 0; i <= rows; i++) {
        const a = (Math.PI / 2) * (from + i / rows);
        profile.push([r * Math.cos(a), r * Math.sin(a) + shift, Math.cos(a), Math.sin(a)]);
      }
    return Mesh.turned(profile, sides);
  },

  // Upright cylinder of radius 1 from z = -1/2 to 1/2.
  cylinder(sides = 28) {
    return Mesh.turned(
      [[0, -0.5, 0, -1], [1, -0.5, 0, -1], [1, -0.5, 1, 0], [1, 0.5, 1, 0], [1, 0.5, 0, 1],
        [0, 0.5, 0, 1]], sides);
  },
};
