// The live viewer: decodes the maps, shades them with viewer.glsl, and follows pointer, keys and controls. It draws only when
// something changed and never moves by itself. Lengths are in patch sides; +x right, +y up, +z toward the viewer.
"use strict";
(() => {
  const section = document.currentScript.closest("section");
  const find = (selector) => section.querySelector(selector);
  const [canvas, form, status] = ["canvas", "form", ".status"].map(find);
  const about = JSON.parse(find(".about").textContent);
  const names = about.maps.map((map) => map.name);
  const [colour, second] = names;

  const start = () => ({
    surface: "patch", show: "lit",
    light: [0.3, 0.35, 1],   // above the patch; of the sphere: right, up and toward the camera from its foremost point
    turn: [0, 0],             // of the camera around the surface, degrees to the right and up
    exposure: 0,              // stops
    roughnessScale: 1, tiles: 1,
    maps: Object.fromEntries(names.map((name) => [name, true])),
  });
  const state = start();
  const DISTANCE = 3, FILL = 0.94;  // of the camera from the centre; how much of the picture the surface fills
  const LIMITS = { exposure: [-4, 4], roughnessScale: [0.25, 3], tiles: [1, 4] };

  const clamp = (x, low, high) => Math.min(Math.max(x, low), high);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const along = (axes, [x, y, z]) => [0, 1, 2].map((i) => axes[0][i] * x + axes[1][i] * y + axes[2][i] * z);

  // ---- Maps ------------------------------------------------------------------------------------------------------------
  // As `encode` in report/viewer.py writes them: per channel a plane of high bytes, then one of low bytes.
  async function decodeMaps() {
    const text = atob(find(".payload").textContent);
    const packed = new Uint8Array(text.length);
    for (let i = 0; i < text.length; i++) packed[i] = text.charCodeAt(i);
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
    const maps = {};
    let at = 0;
    for (const { name, coding, top, height, width, low, high } of about.maps) {
      const count = height * width;
      const channels = low.map((least, channel) => {
        const values = new Float32Array(count), step = (high[channel] - least) / top;
        for (let i = 0; i < count; i++) {
          const x = least + (256 * bytes[at + i] + bytes[at + count + i]) * step;
          values[i] = coding === "square" ? x * x : x;
        }
        at += 2 * count;
        return values;
      });
      maps[name] = coding === "octahedral" ? directions(channels) : channels;
    }
    return maps;
  }

  function directions([s, t]) {
    const out = [0, 1, 2].map(() => new Float32Array(s.length));
    for (let i = 0; i < s.length; i++) {
      const x = (s[i] + t[i]) / 2, y = (s[i] - t[i]) / 2, z = 1 - Math.abs(x) - Math.abs(y), length = Math.hypot(x, y, z);
      [out[0][i], out[1][i], out[2][i]] = [x / length, y / length, z / length];
    }
    return out;
  }

  // ---- WebGL2 ----------------------------------------------------------------------------------------------------------
  const VERTEX = `#version 300 es
    void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0, 1); }`;

  function programOf(gl) {
    const number = (x) => x.toExponential(8);
    const head = ["#version 300 es", about.bsdf === "principled" ? "#define PRINCIPLED" : "",
      `#define MIN_ALPHA ${number(about.min_alpha)}`, `#define DIELECTRIC_F0 ${number(about.dielectric_f0)}`,
      `#define F0_LOW ${number(about.f0_range[0])}`, `#define F0_HIGH ${number(about.f0_range[1])}`].join("\n");
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, head + "\n" + find(".shader").textContent]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) throw Error(gl.getShaderInfoLog(shader));
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw Error(gl.getProgramInfoLog(program));
    return program;
  }

  class Screen {
    constructor(maps) {
      const gl = this.gl = canvas.getContext("webgl2", { antialias: false, depth: false, preserveDrawingBuffer: true });
      if (!gl) throw Error("The live viewer needs WebGL2, which this browser does not offer or has switched off.");
      this.program = programOf(gl);
      this.places = {};
      gl.useProgram(this.program);
      const one = (name) => maps[name].length === 1 ? [0, 0, 0].map(() => maps[name][0]) : maps[name];
      this.texture(0, "colourMap", [...one(colour), ...maps.roughness]);
      this.texture(1, "secondMap", one(second));
      this.texture(2, "normalMap", maps.normal);
    }

    texture(unit, name, channels) {
      const gl = this.gl, { height, width } = about.maps[0], texels = new Float32Array(4 * height * width);
      channels.forEach((values, channel) => { for (let i = 0; i < values.length; i++) texels[4 * i + channel] = values[i]; });
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, texels);
      for (const key of ["MIN_FILTER", "MAG_FILTER"]) gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${key}`], gl.NEAREST);
      gl.uniform1i(this.place(name), unit);
    }

    place(name) { return this.places[name] ??= this.gl.getUniformLocation(this.program, name); }

    draw(scene, width, height, samples, { linear = false, from = 0, rows = height } = {}) {
      const gl = this.gl, floats = (name, values) => gl[`uniform${values.length}f`](this.place(name), ...values);
      const integer = (name, value) => gl.uniform1i(this.place(name), value);
      for (const name of ["camera", "light", "intensity"]) floats(name, scene[name]);
      gl.uniformMatrix3fv(this.place("axes"), false, scene.axes.flat());
      floats("span", [width, height]);
      floats("zoom", [scene.zoom]);
      floats("exposure", [2 ** scene.exposure]);
      floats("roughnessScale", [scene.roughnessScale]);
      floats("uses", [colour, second, "roughness", "normal"].map((name) => Number(scene.maps[name])));
      integer("surface", ["rectified", "patch", "sphere"].indexOf(scene.surface));
      integer("show", ["lit", colour, second, "roughness", "normal"].indexOf(scene.show));
      integer("samples", samples);
      integer("tiles", scene.tiles);
      integer("linearOutput", Number(linear));
      gl.viewport(0, 0, width, height);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, height - from - rows, width, rows);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }

    wait() { this.gl.readPixels(0, 0, 1, 1, this.gl.RGBA, this.gl.UNSIGNED_BYTE, new Uint8Array(4)); }  // until all is drawn

    read(scene, size, samples, linear) {
      const gl = this.gl, frame = gl.createFramebuffer(), store = gl.createRenderbuffer();
      if (linear && !gl.getExtension("EXT_color_buffer_float")) throw Error("this card cannot draw floats");
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      gl.bindRenderbuffer(gl.RENDERBUFFER, store);
      gl.renderbufferStorage(gl.RENDERBUFFER, linear ? gl.RGBA32F : gl.RGBA8, size, size);
      gl.framebufferRenderbuffer(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.RENDERBUFFER, store);
      this.draw(scene, size, size, samples, { linear });
      const upsideDown = linear ? new Float32Array(4 * size * size) : new Uint8Array(4 * size * size);
      gl.readPixels(0, 0, size, size, gl.RGBA, linear ? gl.FLOAT : gl.UNSIGNED_BYTE, upsideDown);
      gl.deleteFramebuffer(frame);
      gl.deleteRenderbuffer(store);
      const pixels = upsideDown.slice(), row = 4 * size;
      for (let y = 0; y < size; y++) pixels.set(upsideDown.subarray(y * row, (y + 1) * row), (size - 1 - y) * row);
      return pixels;
    }
  }

  // ---- Scene -----------------------------------------------------------------------------------------------------------
  // What the shader needs: the state with overrides. If no intensity is given, a white diffuse texel that faces the light from
  // the centre of the patch, or from the sphere's foremost point, has radiance 1 wherever the light is.
  function sceneOf(overrides = {}) {
    const scene = { ...state, ...overrides, maps: { ...state.maps, ...overrides.maps } };
    const [across, up] = scene.turn.map((degrees) => degrees * Math.PI / 180);
    const back = [Math.sin(across) * Math.cos(up), Math.sin(up), Math.cos(across) * Math.cos(up)];
    const right = [Math.cos(across), 0, -Math.sin(across)];
    const above = [back[1] * right[2], back[2] * right[0] - back[0] * right[2], -back[1] * right[0]];
    scene.axes = [right, above, back];
    scene.camera = overrides.camera ?? back.map((x) => DISTANCE * x);
    scene.zoom = FILL / reachOf(scene);
    const power = Math.PI * dot(scene.light, scene.light);
    scene.intensity = overrides.intensity ?? [power, power, power];
    if (scene.surface === "sphere") scene.light = along(scene.axes, [scene.light[0], scene.light[1], scene.light[2] + 0.5]);
    return scene;
  }

  // How far the surface reaches from the middle of the picture, as a tangent.
  function reachOf({ surface, axes, camera }) {
    if (surface === "sphere") return 0.5 / Math.sqrt(dot(camera, camera) - 0.25);
    const corners = [[-0.5, -0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 0.5]];
    return Math.max(...corners.map(([x, y]) => {
      const [right, above, back] = axes.map((axis) => dot(axis, [x - camera[0], y - camera[1], -camera[2]]));
      return Math.max(Math.abs(right), Math.abs(above)) / -back;
    }));
  }

  const follow = (x, y) => set({ light: lightAt(x, y) });  // what the pointer does

  // Where the pointer puts the light: above the point of the patch under it; beside the sphere's foremost point.
  function lightAt(x, y) {
    const scene = sceneOf();
    if (state.surface === "sphere") return [x, y, state.light[2]];
    const ray = along(scene.axes, [x, y, -scene.zoom]);
    const length = ray[2] < 0 ? -scene.camera[2] / ray[2] : 1e3;
    return [scene.camera[0] + length * ray[0], scene.camera[1] + length * ray[1], state.light[2]];
  }

  // ---- Drawing, when something changed -----------------------------------------------------------------------------------
  const REST = 120, PAUSE = 100;  // milliseconds: without a change before the fine drawing; for one stripe of it
  let screen = null, maps = null, asked = 0, settle = 0, fine = false;

  function draw(samples, from = 0, rows = canvas.height) {
    if (!screen || screen.gl.isContextLost()) return;
    screen.draw(sceneOf(), canvas.width, canvas.height, samples, { from, rows });
  }

  function rough() {
    const side = Math.round(clamp(canvas.clientWidth * devicePixelRatio, 1, 2048));
    if (canvas.width !== side) canvas.width = canvas.height = side;
    draw(1);
  }

  // Nine samples a pixel on plain screens, four on those of phones; from the top, as many rows at once as the card can.
  function refine(from = 0, rows = 16) {
    if (!screen || screen.gl.isContextLost()) return;
    if (from === 0) screen.wait();  // for what was drawn roughly, or the first stripe would seem slow
    const began = performance.now(), side = canvas.height;
    rows = Math.min(rows, side - from);
    draw(Math.ceil(3 / devicePixelRatio), from, rows);
    screen.wait();
    fine = from + rows === side;
    const next = Math.ceil(clamp(rows * PAUSE / (performance.now() - began), 1, 4 * rows));
    if (!fine) settle = setTimeout(refine, 0, from + rows, next);
  }

  function redraw() {  // one sample a pixel while it moves
    clearTimeout(settle);
    fine = false;
    asked ||= requestAnimationFrame(() => {
      asked = 0;
      rough();
      settle = setTimeout(refine, REST);
    });
  }

  const told = {
    exposure: (x) => `${x > 0 ? "+" : x < 0 ? "−" : ""}${Math.abs(x).toFixed(2)} stops`, roughnessScale: (x) => `× ${x.toFixed(2)}`,
    height: (x) => `${x.toFixed(2)} sides`, tiles: (x) => `${x} × ${x}`,
  };

  function tell() {
    for (const name of ["surface", "show"]) form.elements[name].value = state[name];
    for (const name of names) form.querySelector(`input[type=checkbox][name=${name}]`).checked = state.maps[name];
    for (const [name, text] of Object.entries(told)) {
      const input = form.elements[name], value = name === "height" ? state.light[2] : state[name];
      input.value = value;
      input.previousElementSibling.textContent = text(value);
      input.setAttribute("aria-valuetext", text(value));
    }
    for (const set of form.querySelectorAll(".lit")) set.disabled = state.show !== "lit";
    const signed = (x, digits) => (x < 0 ? "−" : "") + Math.abs(x).toFixed(digits);
    status.textContent = `Light ${state.light.map((x) => signed(x, 2)).join(", ")} · view ${state.turn.map((x) => signed(x, 0)).join("°, ")}°`;
  }

  function set(changes) {
    Object.assign(state, changes, { maps: { ...state.maps, ...changes.maps } });
    for (const [name, [low, high]] of Object.entries(LIMITS)) state[name] = clamp(state[name], low, high);
    const [x, y, z] = state.light;
    state.light = [clamp(x, -1.5, 1.5), clamp(y, -1.5, 1.5), clamp(z, 0.1, 3)];
    state.turn = state.turn.map((angle) => clamp(angle, -80, 80));
    tell();
    redraw();
  }

  // ---- Pointer, keys, controls ---------------------------------------------------------------------------------------------
  const fingers = new Map();  // pointers that are down, and where each was last
  const place = (event) => {
    const box = canvas.getBoundingClientRect();
    return [(event.clientX - box.left) / box.width * 2 - 1, 1 - (event.clientY - box.top) / box.height * 2];
  };

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button > 0) return;
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, place(event));
    if (event.pointerType === "touch" && fingers.size === 1) follow(...place(event));
  });
  canvas.addEventListener("pointermove", (event) => {
    const at = place(event), before = fingers.get(event.pointerId);
    const turning = before && (event.pointerType !== "touch" || fingers.size > 1);
    canvas.classList.toggle("turning", Boolean(turning));
    if (turning) {
      const part = 60 / fingers.size;
      set({ turn: [state.turn[0] - part * (at[0] - before[0]), state.turn[1] - part * (at[1] - before[1])] });
    } else follow(...at);
    if (before) fingers.set(event.pointerId, at);
  });
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => {
    fingers.delete(event.pointerId);
    canvas.classList.remove("turning");
  });

  canvas.addEventListener("keydown", (event) => {
    const arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    const rise = { "+": 1, "=": 1, "-": -1 }[event.key];
    if (event.ctrlKey || event.altKey || event.metaKey || !(arrow || rise)) return;
    event.preventDefault();
    const [x, y, z] = state.light;
    if (rise) set({ light: [x, y, z + 0.05 * rise] });
    else if (event.shiftKey) set({ turn: state.turn.map((angle, i) => angle - 5 * arrow[i]) });
    else set({ light: [x + 0.05 * arrow[0], y + 0.05 * arrow[1], z] });
  });

  form.addEventListener("input", ({ target }) => {
    if (target.type === "checkbox") set({ maps: { [target.name]: target.checked } });
    else if (target.name === "height") set({ light: [state.light[0], state.light[1], Number(target.value)] });
    else set({ [target.name]: target.type === "range" ? Number(target.value) : target.value });
  });
  form.addEventListener("reset", (event) => { event.preventDefault(); set(start()); });
  form.addEventListener("submit", (event) => event.preventDefault());

  canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); screen = null; });
  canvas.addEventListener("webglcontextrestored", () => { screen = new Screen(maps); redraw(); });
  new ResizeObserver(redraw).observe(canvas);

  function problem(text) {
    find(".problem").textContent = text;
    find(".problem").hidden = false;
    find(".stage").hidden = form.hidden = true;
    return false;
  }

  async function begin() {
    try {
      if (!window.DecompressionStream) throw Error("The live viewer needs a browser of 2023 or later (DecompressionStream).");
      maps = await decodeMaps();
      screen = new Screen(maps);
    } catch (error) {
      return problem(error.message);
    }
    set({});
    rough();
    return true;
  }

  let begun = null;
  new IntersectionObserver((seen, watch) => {  // a page that is not read that far opens without it
    if (seen.some((each) => each.isIntersecting)) { watch.disconnect(); begun ??= begin(); }
  }).observe(section);

  window.mitsvbrdfViewer = {
    state, set,
    get ready() { return begun ??= begin(); },  // whether it can draw
    get fine() { return fine; },  // whether the fine drawing is complete
    // Pixels of a square picture, four values each, row 0 at the top: bytes of sRGB, or, if `linear`, floats of linear
    // radiance. State that is not given stays as it is. view: patch, sphere, or rectified, where pixel = texel
    // for camera and light at these positions. intensity: of the light, rgb; default: pi |light|^2.
    // axes (right, up, back) and zoom: of the camera of patch and sphere.
    pixels({ view = "rectified", size = about.resolution, samples = 1, linear = false, ...overrides } = {}) {
      const scene = sceneOf({ ...overrides, surface: view }), data = screen.read(scene, size, samples, linear);
      return { size, data, camera: scene.camera, light: scene.light, axes: scene.axes, zoom: scene.zoom };
    },
  };
})();
