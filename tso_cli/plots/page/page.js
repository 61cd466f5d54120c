"use strict";
(() => {
  const byId = (id) => document.getElementById(id);
  const solid = JSON.parse(byId("solid").textContent);

  // Outlines and photos

  for (const name of ["line-mask", "line-start", "line-result", "photo"]) {
    const box = byId(name);
    const apply = () => document.body.classList.toggle(`hide-${name}`, !box.checked);
    if (box) { box.addEventListener("change", apply); apply(); }
  }

  // Blocks to copy

  for (const button of document.querySelectorAll("[data-copy]")) {
    button.addEventListener("click", async () => {
      const block = byId(button.dataset.copy);
      const range = document.createRange();
      range.selectNodeContents(block);
      getSelection().removeAllRanges();
      getSelection().addRange(range);
      let done = false;
      try { await navigator.clipboard.writeText(block.textContent); done = true; }
      catch { done = document.execCommand("copy"); }
      button.textContent = done ? "Copied" : "Selected";
      setTimeout(() => { button.textContent = "Copy"; }, 1600);
    });
  }

  // Numbers

  const bytes = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  function unpacked({ low, span, data }) {
    const steps = new Uint16Array(bytes(data).buffer);
    const values = new Float32Array(steps.length);
    for (let i = 0; i < steps.length; i++) {
      values[i] = low[i % low.length] + steps[i] * span[i % low.length];
    }
    return values;
  }

  // Colours: three.js wants linear ones

  const linear = (c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4);
  const style = getComputedStyle(document.documentElement);
  const named = (name) => new THREE.Color(style.getPropertyValue(name).trim());
  const RAMP = ["#4169d8", "#2ba3b4", "#5cc863", "#c9dd3c", "#fff27a"].map((c) => new THREE.Color(c));
  const STAGE = new THREE.Color("#20262d");

  function rampColours(lengths, largest) {
    const colours = new Float32Array(3 * lengths.length);
    const colour = new THREE.Color();
    for (let i = 0; i < lengths.length; i++) {
      const place = Math.min(1, lengths[i] / (largest || 1)) * (RAMP.length - 1);
      const first = Math.min(RAMP.length - 2, Math.floor(place));
      colour.lerpColors(RAMP[first], RAMP[first + 1], place - first).toArray(colours, 3 * i);
    }
    return colours;
  }
  const ofBytes = (text) => Float32Array.from(bytes(text), (value) => linear(value / 255));

  // The three-dimensional view

  const canvas = byId("canvas");
  const said = byId("said");
  let renderer;
  try {
    renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  } catch {
    said.textContent = "This browser has no WebGL, which the three-dimensional view needs.";
    document.documentElement.dataset.ready = "without WebGL";
    return;
  }
  renderer.setPixelRatio(Math.min(devicePixelRatio || 1, 2));
  renderer.setClearColor(STAGE);
  const world = new THREE.Scene();
  const eye = new THREE.PerspectiveCamera(35, 1, 0.01, 100);
  world.add(new THREE.AmbientLight(0xffffff, 1.6));
  const lamp = new THREE.DirectionalLight(0xffffff, 1.9);
  lamp.position.set(0.4, 0.7, 1);
  eye.add(lamp);
  world.add(eye);

  const start = unpacked(solid.start);
  const result = unpacked(solid.result);
  const moved = unpacked(solid.moved);
  const stages = { start: null, result: null };
  const images = [];

  function pictureOf(uri, whenThere) {
    const picture = new Image();
    const texture = new THREE.Texture(picture);
    texture.colorSpace = THREE.SRGBColorSpace;
    texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
    images.push(new Promise((done) => {
      picture.onload = () => { texture.needsUpdate = true; done(); if (whenThere) whenThere(); };
      picture.onerror = done;
    }));
    picture.src = uri;
    return texture;
  }

  function disc() {
    const drawn = document.createElement("canvas");
    drawn.width = drawn.height = 32;
    const pen = drawn.getContext("2d");
    pen.fillStyle = "#fff";
    pen.arc(16, 16, 15, 0, 2 * Math.PI);
    pen.fill();
    const texture = new THREE.Texture(drawn);
    texture.needsUpdate = true;
    return texture;
  }

  const attribute = (values, size) => new THREE.Float32BufferAttribute(values, size);

  // The start does not hide the result.
  function seenThrough(material, opacity) {
    material.transparent = opacity < 1;
    material.opacity = opacity;
    material.depthWrite = opacity === 1;
  }

  function pointStage(positions, name) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", attribute(positions, 3));
    const size = Math.max(1.6, Math.min(8, 230 / Math.sqrt(solid.count)));
    const material = new THREE.PointsMaterial({
      size: size * renderer.getPixelRatio(), sizeAttenuation: false, map: disc(), alphaTest: 0.5,
    });
    const whole = material.size;
    const colours = {
      moved: attribute(rampColours(moved, solid.largest), 3),
      own: solid.colours ? attribute(ofBytes(solid.colours), 3) : null,
    };
    const points = new THREE.Points(geometry, material);
    return {
      object: points,
      colour(mode) {
        const chosen = colours[mode];
        if (chosen) geometry.setAttribute("color", chosen);
        material.vertexColors = Boolean(chosen);
        material.color = chosen ? new THREE.Color(0xffffff) : named(`--${name}`);
        material.needsUpdate = true;
      },
      clear(through) {
        material.size = (through ? 0.6 : 1) * whole;
        seenThrough(material, through ? 0.8 : 1);
      },
    };
  }

  let faces = null;
  let textures = [];
  if (solid.kind === "mesh") {
    const data = bytes(solid.faces).buffer;
    faces = solid.wide ? new Uint32Array(data) : new Uint16Array(data);
    textures = solid.textures.map((uri) => pictureOf(uri, () => draw()));
  }

  function byCorner(values, size) {
    const corners = new Float32Array(faces.length * size);
    for (let i = 0; i < faces.length; i++) {
      for (let k = 0; k < size; k++) corners[i * size + k] = values[faces[i] * size + k];
    }
    return corners;
  }

  function byFace(values) {
    const corners = new Float32Array(3 * values.length);
    for (let i = 0; i < corners.length; i++) corners[i] = values[3 * Math.floor(i / 9) + (i % 3)];
    return corners;
  }

  function meshStage(positions, name) {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", attribute(byCorner(positions, 3), 3));
    geometry.computeVertexNormals();
    if (solid.uv) geometry.setAttribute("uv", attribute(unpacked(solid.uv), 2));
    solid.groups.forEach((group, i) => geometry.addGroup(3 * group.first, 3 * group.count, i));
    let own = null;
    if (solid.faceColours) own = attribute(byFace(ofBytes(solid.faceColours)), 3);
    if (solid.vertexColours) own = attribute(byCorner(ofBytes(solid.vertexColours), 3), 3);
    const colours = { moved: attribute(byCorner(rampColours(moved, solid.largest), 3), 3), own };
    const looks = { side: THREE.DoubleSide };
    const plain = new THREE.MeshLambertMaterial(looks);
    const pictured = solid.groups.map((group) => (group.texture < 0
      ? new THREE.MeshLambertMaterial({ ...looks, vertexColors: Boolean(own), color: own ? 0xffffff : 0xaaaaaa })
      : new THREE.MeshLambertMaterial({ ...looks, map: textures[group.texture] })));
    const mesh = new THREE.Mesh(geometry, solid.groups.map(() => plain));
    return {
      object: mesh,
      colour(mode) {
        const chosen = colours[mode];
        if (chosen) geometry.setAttribute("color", chosen);
        plain.vertexColors = Boolean(chosen);
        plain.color = chosen ? new THREE.Color(0xffffff) : named(`--${name}`);
        plain.needsUpdate = true;
        mesh.material = mode === "own" ? pictured : solid.groups.map(() => plain);
      },
      clear(through) {
        for (const material of [plain, ...pictured]) seenThrough(material, through ? 0.4 : 1);
      },
    };
  }

  const stage = faces ? meshStage : pointStage;
  stages.start = stage(start, "start");
  stages.result = stage(result, "result");
  if (!faces) world.fog = new THREE.Fog(STAGE, 1, 4);
  world.add(stages.start.object, stages.result.object);

  // Cameras

  const perspective = (camera) => camera.model === "perspective";
  // A point in the axes of a camera, in the axes of the cloud.
  function toWorld({ R, t }, [x, y, z]) {
    const [a, b, c] = [x - t[0], y - t[1], z - t[2]];
    return new THREE.Vector3(...[0, 1, 2].map((k) => R[0][k] * a + R[1][k] * b + R[2][k] * c));
  }
  function cornersAt(camera, [left, top, right, bottom], depth) {
    const K = camera.K;
    const scale = perspective(camera) ? depth : 1;
    return [[left, top], [right, top], [right, bottom], [left, bottom]].map(([u, v]) => {
      const y = (v - K[1][2]) / K[1][1];
      const x = (u - K[0][2] - K[0][1] * y) / K[0][0];
      return toWorld(camera, [x * scale, y * scale, depth]);
    });
  }
  const whole = ({ width, height }) => [-0.5, -0.5, width - 0.5, height - 0.5];
  const distanceOf = ({ t }) => Math.hypot(...t);
  const placeOf = (camera) => toWorld(camera, perspective(camera) ? [0, 0, 0] : [camera.t[0], camera.t[1], camera.t[2] - 2]);

  const frustums = new THREE.Group();
  const corners = []; // of their lines
  const labels = solid.cameras.map((camera, number) => {
    const far = perspective(camera) ? Math.min(0.2 * camera.t[2], 0.3) : camera.t[2] - 1.2;
    const near = perspective(camera) ? 0 : camera.t[2] - 2;
    const ends = cornersAt(camera, whole(camera), far);
    const starts = cornersAt(camera, whole(camera), near);
    const lines = [];
    ends.forEach((end, i) => {
      lines.push(starts[i], end, end, ends[(i + 1) % 4]);
      if (!perspective(camera)) lines.push(starts[i], starts[(i + 1) % 4]);
    });
    // A roof shows which side is up.
    const middle = ends[0].clone().add(ends[1]).multiplyScalar(0.5);
    const below = ends[2].clone().add(ends[3]).multiplyScalar(0.5);
    const roof = middle.clone().add(middle.clone().sub(below).multiplyScalar(0.25));
    lines.push(ends[0].clone().lerp(middle, 0.5), roof, roof, ends[1].clone().lerp(middle, 0.5));
    for (const point of lines) corners.push(...point);
    const geometry = new THREE.BufferGeometry().setFromPoints(lines);
    frustums.add(new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: 0xc8d2db, fog: false })));
    const label = document.createElement("span");
    label.className = "tag";
    label.textContent = String(number + 1);
    canvas.parentElement.append(label);
    return { label, place: roof };
  });
  world.add(frustums);

  // The picture behind, for the look through a camera

  const backdrops = new Map();
  function backdropOf(number) {
    const box = solid.backdrops[number];
    const shown = byId(`base-${number}`);
    if (!box || !shown) return null;
    if (!backdrops.has(number)) {
      const camera = solid.cameras[number];
      const [a, b, c, d] = cornersAt(camera, box, camera.t[2] + 3);
      const geometry = new THREE.BufferGeometry().setFromPoints([a, d, c, a, c, b]);
      geometry.setAttribute("uv", attribute([0, 1, 0, 0, 1, 0, 0, 1, 1, 0, 1, 1], 2));
      const map = pictureOf(shown.getAttribute("href"), () => draw());
      const plane = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({
        map, side: THREE.DoubleSide, fog: false, depthWrite: false, color: 0xb0b0b0,
      }));
      plane.renderOrder = -1;
      world.add(plane);
      backdrops.set(number, plane);
    }
    return backdrops.get(number);
  }

  // Where the eye is

  let through = null;
  // The axis that is most upright in the first camera stays upright.
  const tilted = solid.cameras[0].R[1].map((value) => -value);
  const axis = tilted.reduce((best, value, k) => (Math.abs(value) > Math.abs(tilted[best]) ? k : best), 0);
  const upright = new THREE.Vector3().setComponent(axis, Math.sign(tilted[axis]) || 1);
  eye.up.copy(upright);
  // The controls keep the axis that they find.
  const controls = new THREE.OrbitControls(eye, canvas);
  controls.enablePan = false;

  // How far the eye must be, in its direction, so that ``points`` (three numbers each) are within
  // these tangents of the angles to the middle.
  function distanceFor(points, wide, high) {
    const away = eye.position.clone().normalize();
    const right = new THREE.Vector3().crossVectors(upright, away).normalize();
    const above = new THREE.Vector3().crossVectors(away, right);
    const point = new THREE.Vector3();
    let distance = 0;
    for (let i = 0; i < points.length; i += 3) {
      point.fromArray(points, i);
      const across = Math.max(Math.abs(point.dot(right)) / wide, Math.abs(point.dot(above)) / high);
      distance = Math.max(distance, point.dot(away) + across);
    }
    return distance;
  }
  const aspect = () => canvas.clientWidth / Math.max(1, canvas.clientHeight);
  const tangent = Math.tan((eye.fov * Math.PI) / 360);

  // The object takes this share of the smaller side.
  function usual() {
    const most = 0.7 * tangent * Math.min(1, aspect());
    return distanceFor(result, most, most);
  }

  function leave() {
    if (through === null) return;
    through = null;
    eye.position.normalize().multiplyScalar(usual());
    controls.target.set(0, 0, 0);
    controls.update();
    state();
  }

  function reset() {
    through = null;
    byId("show-cameras").checked = false; // they are seldom in view
    const away = placeOf(solid.cameras[0]);
    if (away.length() < 1e-6) away.set(0.3, 0.2, 1);
    eye.position.copy(away.applyAxisAngle(upright, 0.5));
    eye.position.normalize().multiplyScalar(usual());
    controls.target.set(0, 0, 0);
    controls.update();
    state();
  }

  // Move back until all cameras are in view.
  function seeCameras() {
    leave();
    const distance = Math.max(eye.position.length(), distanceFor(corners, 0.9 * tangent * aspect(), 0.9 * tangent));
    eye.position.normalize().multiplyScalar(distance);
    controls.update();
    state();
  }

  function look(number) {
    through = number;
    const camera = solid.cameras[number];
    const [x, y, z] = camera.R;
    eye.position.copy(placeOf(camera));
    eye.quaternion.setFromRotationMatrix(new THREE.Matrix4().set(
      x[0], -y[0], -z[0], 0, x[1], -y[1], -z[1], 0, x[2], -y[2], -z[2], 0, 0, 0, 0, 1));
    state();
  }

  function project() {
    const distance = eye.position.length();
    eye.aspect = aspect();
    eye.near = Math.max(distance - 40, distance * 0.01, 0.002);
    eye.far = 2 * distance + 12 + Math.min(60, Math.max(...solid.cameras.map(distanceOf)));
    eye.updateProjectionMatrix();
    if (through === null) return;
    const camera = solid.cameras[through];
    let [left, top, right, bottom] = solid.backdrops[through] || camera.window;
    const [width, height] = [right - left, bottom - top];
    // The box in the middle of the canvas, whatever the shape of the canvas.
    const wider = Math.max(0, height * eye.aspect - width) / 2;
    const higher = Math.max(0, width / eye.aspect - height) / 2;
    [left, right, top, bottom] = [left - wider, right + wider, top - higher, bottom + higher];
    const K = camera.K;
    const near = perspective(camera) ? eye.near : 1;
    const edges = [(left - K[0][2]) / K[0][0], (right - K[0][2]) / K[0][0], -(top - K[1][2]) / K[1][1], -(bottom - K[1][2]) / K[1][1]];
    if (perspective(camera)) eye.projectionMatrix.makePerspective(...edges.map((edge) => edge * near), near, eye.far);
    else {
      const [tx, ty] = camera.t;
      eye.projectionMatrix.makeOrthographic(edges[0] - tx, edges[1] - tx, edges[2] + ty, edges[3] + ty, 0.01, eye.far);
    }
    eye.projectionMatrixInverse.copy(eye.projectionMatrix).invert();
  }

  // Drawing

  let asked = false;
  function draw() {
    if (!asked) { asked = true; requestAnimationFrame(drawNow); }
  }

  function drawNow() {
    asked = false;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = renderer.getPixelRatio();
    if (canvas.width !== Math.floor(width * ratio) || canvas.height !== Math.floor(height * ratio)) {
      renderer.setSize(width, height, false);
    }
    project();
    if (world.fog) {
      // Against a bright picture the fog would darken instead of fade.
      const distance = eye.position.length() + (through === null ? 0 : 100);
      world.fog.near = distance - 0.5;
      world.fog.far = distance + 1.6;
    }
    for (const plane of backdrops.values()) plane.visible = false;
    const box = byId("backdrop");
    const plane = through !== null && box && box.checked ? backdropOf(through) : null;
    if (plane) plane.visible = true;
    frustums.visible = byId("show-cameras").checked && through === null;
    renderer.render(world, eye);
    for (const { label, place } of labels) {
      const seen = place.clone().project(eye);
      const inside = Math.abs(seen.x) < 0.97 && Math.abs(seen.y) < 0.97 && seen.z < 1;
      label.hidden = !(frustums.visible && inside);
      label.style.transform = `translate(${((seen.x + 1) / 2) * width}px,${((1 - seen.y) / 2) * height}px)`;
    }
    Promise.all(images).then(() => { document.documentElement.dataset.ready = "yes"; });
  }

  const swatch = byId("show-result").nextElementSibling;
  function state() {
    const both = byId("show-start").checked && byId("show-result").checked;
    const mode = document.querySelector("input[name=colour]:checked").value;
    stages.start.object.visible = byId("show-start").checked;
    stages.result.object.visible = byId("show-result").checked;
    stages.start.colour(mode === "own" ? "own" : "plain");
    stages.result.colour(mode);
    stages.start.clear(both);
    swatch.style.background = mode === "moved" ? "var(--ramp)" : "";
    swatch.hidden = mode === "own";
    byId("scale").hidden = mode !== "moved" || !byId("show-result").checked;
    for (const button of document.querySelectorAll(".look")) {
      button.setAttribute("aria-pressed", String(through !== null && numberOf(button) === through));
    }
    const name = through === null ? "" : solid.cameras[through].name.split("/").pop();
    said.textContent = through === null ? "" : `Through camera ${through + 1}, ${name}`;
    draw();
  }

  const numberOf = (button) => Number(button.dataset.view ?? byId("which").value);
  for (const button of document.querySelectorAll(".look")) {
    button.addEventListener("click", () => (numberOf(button) === through ? reset() : look(numberOf(button))));
  }
  for (const input of document.querySelectorAll(".solid-section input")) input.addEventListener("change", state);
  byId("show-cameras").addEventListener("change", (event) => { if (event.target.checked) seeCameras(); });
  byId("reset").addEventListener("click", reset);
  controls.addEventListener("start", leave);
  controls.addEventListener("change", draw);
  canvas.addEventListener("keydown", (event) => {
    const turn = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    const zoom = { "+": 0.88, "=": 0.88, "-": 1.14 }[event.key];
    if (!turn && !zoom && event.key !== "0") return;
    event.preventDefault();
    if (event.key === "0") { reset(); return; }
    leave();
    if (zoom) eye.position.multiplyScalar(zoom);
    else {
      const side = new THREE.Vector3().crossVectors(eye.position, upright).normalize();
      eye.position.applyAxisAngle(upright, 0.12 * turn[0]);
      const tilt = eye.position.clone().applyAxisAngle(side, 0.12 * turn[1]);
      if (tilt.angleTo(upright) > 0.1 && tilt.angleTo(upright) < Math.PI - 0.1) eye.position.copy(tilt);
    }
    controls.update();
    draw();
  });
  new ResizeObserver(draw).observe(canvas);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", draw);
  reset();
})();
