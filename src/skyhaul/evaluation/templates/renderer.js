// A small WebGL 2 renderer: lit meshes, their shadow straight below, thick lines.
"use strict";
const MESH_VERTEX = `#version 300 es
in vec3 position; in vec3 normal;
uniform mat4 world; uniform mat4 viewProjection; uniform float flat_;
out vec3 n; out vec3 at;
void main() {
  vec4 p = world * vec4(position, 1.0);
  if (flat_ > 0.5) p.z = 0.004;
  n = mat3(world) * normal; at = p.xyz;
  gl_Position = viewProjection * p;
}`;
const MESH_FRAGMENT = `#version 300 es
precision highp float;
in vec3 n; in vec3 at; out vec4 color;
uniform vec4 tint; uniform vec3 eye; uniform float flat_; uniform vec3 fog; uniform float far;
void main() {
  float fade = smoothstep(0.55 * far, far, distance(at, eye));
  if (flat_ > 0.5) { color = vec4(mix(tint.rgb, fog, fade), tint.a); return; }
  vec3 m = normalize(n);
  vec3 toEye = normalize(eye - at);
  if (dot(m, toEye) < 0.0) m = -m;
  float sun = max(dot(m, normalize(vec3(0.35, -0.5, 0.85))), 0.0);
  float sky = 0.5 + 0.5 * m.z;
  float rim = pow(1.0 - max(dot(m, toEye), 0.0), 3.0);
  vec3 lit = tint.rgb * (0.34 + 0.24 * sky + 0.52 * sun) + 0.10 * rim * tint.a;
  color = vec4(mix(lit, fog, fade), tint.a);
}`;
const LINE_VERTEX = `#version 300 es
in vec2 corner; in vec3 a; in vec3 b; in vec4 tint; in float width;
uniform mat4 viewProjection; uniform vec2 size;
out vec4 shade;
void main() {
  vec4 p = viewProjection * vec4(a, 1.0), q = viewProjection * vec4(b, 1.0);
  if (p.w < 0.01) p = mix(p, q, (0.01 - p.w) / (q.w - p.w));
  if (q.w < 0.01) q = mix(q, p, (0.01 - q.w) / (p.w - q.w));
  vec2 d = (q.xy / q.w - p.xy / p.w) * size;
  d = length(d) > 1e-6 ? normalize(d) : vec2(1.0, 0.0);
  vec4 end = corner.x < 0.5 ? p : q;
  vec2 out_ = vec2(-d.y, d.x) * corner.y + d * (corner.x * 2.0 - 1.0) * 0.5;
  end.xy += out_ * width / size * end.w;
  shade = tint;
  gl_Position = end;
}`;
const LINE_FRAGMENT = `#version 300 es
precision highp float;
in vec4 shade; out vec4 color;
void main() { color = shade; }`;

class Renderer {
  constructor(canvas) {
    this.canvas = canvas;
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("no WebGL 2");
    this.gl = gl;
    this.mesh = this.program(MESH_VERTEX, MESH_FRAGMENT);
    this.line = this.program(LINE_VERTEX, LINE_FRAGMENT);
    this.corners = this.buffer([0, -1, 1, -1, 1, 1, 0, -1, 1, 1, 0, 1]);
    this.scratch = gl.createBuffer();
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  }

  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    const at = (name) => gl.getUniformLocation(program, name);
    const slot = (name) => gl.getAttribLocation(program, name);
    return { program, at, slot, cache: {} };
  }

  buffer(values) {
    const gl = this.gl, id = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, id);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
    return id;
  }

  // A mesh for `drawMeshes`, from Mesh.* values.
  upload(values) {
    return { id: this.buffer(values), count: values.length / 6 };
  }

  // Segments for `drawLines`: each [a, b, rgba, width in pixels].
  segments(list) {
    const out = new Float32Array(list.length * 11);
    list.forEach(([a, b, tint, width], k) => out.set([...a, ...b, ...tint, width], 11 * k));
    return out;
  }

  begin(viewProjection, eye, background, far) {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(this.canvas.clientWidth * ratio);
    const height = Math.round(this.canvas.clientHeight * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    Object.assign(this, { viewProjection, eye, background, far, ratio, width, height });
    gl.viewport(0, 0, width, height);
    gl.clearColor(...background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  // Items: { mesh, world, tint }. With `flat` they are pressed on the floor, as shadows.
  drawMeshes(items, flat = false) {
    const gl = this.gl, { program, at, slot } = this.mesh;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at("viewProjection"), false, this.viewProjection);
    gl.uniform3fv(at("eye"), this.eye);
    gl.uniform3fv(at("fog"), this.background);
    gl.uniform1f(at("far"), this.far);
    gl.uniform1f(at("flat_"), flat ? 1 : 0);
    const world = at("world"), tint = at("tint");
    const p = slot("position"), n = slot("normal");
    gl.enableVertexAttribArray(p);
    if (n >= 0) gl.enableVertexAttribArray(n);
    for (const item of items) {
      gl.bindBuffer(gl.ARRAY_BUFFER, item.mesh.id);
      gl.vertexAttribPointer(p, 3, gl.FLOAT, false, 24, 0);
      if (n >= 0) gl.vertexAttribPointer(n, 3, gl.FLOAT, false, 24, 12);
      gl.uniformMatrix4fv(world, false, item.world);
      gl.uniform4fv(tint, item.tint);
      gl.depthMask(item.tint[3] > 0.99);
      gl.drawArrays(gl.TRIANGLES, 0, item.mesh.count);
    }
    gl.depthMask(true);
  }

  drawLines(data) {
    const count = data.length / 11;
    if (!count) return;
    const gl = this.gl, { program, at, slot } = this.line;
    gl.useProgram(program);
    gl.uniformMatrix4fv(at("viewProjection"), false, this.viewProjection);
    gl.uniform2f(at("size"), this.width / this.ratio, this.height / this.ratio);
    const corner = slot("corner");
    gl.bindBuffer(gl.ARRAY_BUFFER, this.corners);
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.scratch);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    const slots = [["a", 3, 0], ["b", 3, 12], ["tint", 4, 24], ["width", 1, 40]];
    for (const [name, width, offset] of slots) {
      gl.enableVertexAttribArray(slot(name));
      gl.vertexAttribPointer(slot(name), width, gl.FLOAT, false, 44, offset);
      gl.vertexAttribDivisor(slot(name), 1);
    }
    gl.drawArraysInstanced(gl.TRIANGLES, 0, 6, count);
    for (const [name] of slots) {
      gl.vertexAttribDivisor(slot(name), 0);
      gl.disableVertexAttribArray(slot(name));
    }
    gl.disableVertexAttribArray(corner);
  }
}
