// Pictures in 3D of a report, seen from far away, so that the scale holds everywhere. Arrays are base64: vertices and
// lines of 32-bit floats (x, y, z; a NaN ends a line), triangles of 32-bit indices.
"use strict";
const buffer = (text) => Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer;
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const scaled = (a, factor) => a.map((value) => value * factor);
const unit = (a) => scaled(a, 1 / Math.hypot(...a));
const rows = (array) => Array.from({ length: array.length / 3 }, (_, row) => array.subarray(3 * row, 3 * row + 3));
const shaded = (rgb, light) => `rgb(${rgb.map((part) => Math.round(part * light))})`;

// Numbers of the segments under the mouse, which are highlighted in all pictures, among the names and in the table.
const pictures = [];
let picked = [];
const isPicked = (shape) => shape.segments.some((segment) => picked.includes(segment));

function pick(segments) {
  if (segments.join() === picked.join()) return;
  picked = segments;
  for (const entry of document.querySelectorAll("[data-segments]"))
    entry.classList.toggle("picked", isPicked({ segments: entry.dataset.segments.split(" ").map(Number) }));
  pictures.forEach((draw) => draw());
}

function linkRows() {
  for (const row of document.querySelectorAll("tr[data-segments]")) {
    row.onmouseenter = () => pick(row.dataset.segments.split(" ").map(Number));
    row.onmouseleave = () => pick([]);
  }
}

function draw3d(picture, { eye, up, shapes }) {
  const [canvas, legend] = picture.children, context = canvas.getContext("2d");
  for (const shape of shapes) {
    shape.points = rows(new Float32Array(buffer(shape.vertices)));
    shape.corners = rows(new Uint32Array(buffer(shape.triangles)));
    shape.strips = [[]];
    for (const point of rows(new Float32Array(buffer(shape.lines))))
      if (isNaN(point[0])) shape.strips.push([]);
      else shape.strips.at(-1).push(point);
  }
  const level = unit(cross(up, eye)), ahead = cross(level, up);
  const steep = Math.atan2(dot(eye, up), dot(eye, ahead));
  const all = shapes.flatMap((shape) => (shape.shown ? [...shape.points, ...shape.strips.flat()] : []));
  const [low, high] = [Math.min, Math.max].map((pick) =>
    [0, 1, 2].map((axis) => all.reduce((value, point) => pick(value, point[axis]), all.length ? all[0][axis] : 0)));
  const centre = low.map((value, axis) => (value + high[axis]) / 2);
  const distance = (point) => Math.hypot(...centre.map((value, axis) => point[axis] - value));
  const radius = all.reduce((most, point) => Math.max(most, distance(point)), 0) || 1;
  let azimuth, elevation, zoom, middle;
  const reset = () => {
    [azimuth, elevation, zoom, middle] = [0, steep, 1, centre];
    draw();
  };

  function draw(at) {  // returns the numbers of the segments drawn at a place
    const [width, height, dots] = [canvas.clientWidth, canvas.clientHeight, devicePixelRatio];
    [canvas.width, canvas.height] = [width * dots, height * dots];
    context.scale(dots, dots);
    context.font = "12px system-ui, sans-serif";
    context.lineJoin = "round";
    const scale = (zoom * Math.min(width, height)) / (2 * radius);
    const right = level.map((value, axis) => value * Math.cos(azimuth) - ahead[axis] * Math.sin(azimuth));
    const flat = level.map((value, axis) => value * Math.sin(azimuth) + ahead[axis] * Math.cos(azimuth));
    const back = flat.map((value, axis) => value * Math.cos(elevation) + up[axis] * Math.sin(elevation));
    const upright = cross(back, right);
    canvas.axes = [right, upright, scale];
    const project = (point) => {
      const from = middle.map((value, axis) => point[axis] - value);
      return [width / 2 + scale * dot(from, right), height / 2 - scale * dot(from, upright), dot(from, back)];
    };
    const trace = (points) => {
      points.forEach(([x, y], number) => (number ? context.lineTo(x, y) : context.moveTo(x, y)));
    };
    const pieces = [], names = [];
    let under = [];
    const depth = (points) => points.reduce((sum, point) => sum + point[2], 0) / points.length;
    const line = (shape, points) => pieces.push([depth(points) + 1e-3 * radius, shape, () => {
      context.strokeStyle = shaded(shape.colour, 1);
      context.lineWidth = shape.width;
      context.beginPath();
      trace(points);
      context.stroke();
    }]);
    for (const shape of shapes.filter((shape) => shape.shown || (picked.length === 1 && isPicked(shape)))) {
      const points = shape.points.map(project);
      const faces = shape.corners.map((corners) => [...corners].map((corner) => points[corner]));
      const normals = faces.map(([a, b, c]) =>
        cross(b.map((value, axis) => value - a[axis]), c.map((value, axis) => value - a[axis])));
      if (shape.opacity < 1 && faces.length)  // one path, as overlapping faces would add up
        pieces.push([depth(points), shape, () => {
          context.globalAlpha *= shape.opacity;
          context.fillStyle = shaded(shape.colour, 1);
          context.beginPath();
          faces.forEach((face, number) => trace(normals[number][2] < 0 ? [...face].reverse() : face));
          context.fill();
        }]);
      else
        faces.forEach((face, number) => pieces.push([depth(face), shape, () => {
          const [x, y, z] = normals[number].map((value, axis) => (axis < 2 ? value : value / scale));
          const light = 0.55 + 0.4 * Math.abs(z) / (Math.hypot(x, y, z) || 1);
          context.fillStyle = context.strokeStyle = shaded(shape.colour, light);
          context.lineWidth = 0.7;
          context.beginPath();
          trace(face);
          context.fill();
          context.stroke();
        }]));
      for (const strip of shape.strips.map((strip) => strip.map(project)))
        for (let end = 1; end < strip.length; end++) line(shape, [strip[end - 1], strip[end]]);
      if (shape.label) names.push([shape.label, project(shape.label_m)]);
    }
    for (const [, shape, paint] of pieces.sort((a, b) => a[0] - b[0])) {
      context.globalAlpha = picked.length && !isPicked(shape) ? 0.06 : 1;
      paint();
      if (at && shape.segments.length && context.isPointInPath(at[0] * dots, at[1] * dots)) under = shape.segments;
    }
    context.globalAlpha = 1;
    context.fillStyle = context.strokeStyle = "#222";
    context.lineWidth = 1;
    const places = [];
    for (const [name, [x, place]] of names.sort((a, b) => a[1][1] - b[1][1])) {  // below each other
      let y = place - 4;
      const half = context.measureText(name).width / 2;
      while (places.some(([u, v, width]) => Math.abs(u - x) < width + half && Math.abs(v - y) < 13)) y += 3;
      places.push([x, y, half]);
      context.fillText(name, x - half, y);
    }
    const axes = ["x", "y", "z"].map((name, axis) => [name, 40 + 26 * right[axis], height - 44 - 26 * upright[axis]]);
    for (const [name, x, y] of axes) {
      context.beginPath();
      trace([[40, height - 44], [x, y]]);
      context.stroke();
      context.fillText(name, x + 2, y);
    }
    const length = 10 ** Math.floor(Math.log10(width / 4 / scale));
    context.fillRect(90, height - 24, length * scale, 2);
    context.fillText(`${length < 1 ? length * 1000 + " mm" : length + " m"}`, 90, height - 30);
    return under;
  }

  for (const name of new Set(shapes.map((shape) => shape.name))) {
    const group = shapes.filter((s) => s.name === name), entry = legend.appendChild(document.createElement("li"));
    entry.textContent = name;
    entry.title = group[0].text;
    if (group[0].segments.length) entry.dataset.segments = group[0].segments.join(" ");
    entry.style.borderColor = shaded(group[0].colour, 1);
    entry.style.opacity = group[0].shown ? 1 : 0.4;
    entry.onmouseenter = () => pick(group[0].segments);
    entry.onmouseleave = () => pick([]);
    entry.onclick = () => {
      group.forEach((shape) => (shape.shown = !shape.shown));
      entry.style.opacity = group[0].shown ? 1 : 0.4;
      draw();
    };
  }
  canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
  canvas.onpointermove = (event) => {
    if (!event.buttons) return pick(draw([event.offsetX, event.offsetY]));
    const [right, upright, scale] = canvas.axes;
    if (event.shiftKey)
      middle = middle.map((value, axis) =>
        value - (right[axis] * event.movementX - upright[axis] * event.movementY) / scale);
    else {
      azimuth += 0.01 * event.movementX;
      elevation = Math.max(-1.57, Math.min(1.57, elevation + 0.01 * event.movementY));
    }
    draw();
  };
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom *= Math.exp(-0.001 * event.deltaY);
    draw();
  }, { passive: false });
  canvas.ondblclick = reset;
  canvas.onpointerleave = () => pick([]);
  pictures.push(draw);
  addEventListener("resize", () => draw());
  reset();
}
