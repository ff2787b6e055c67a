function play(box, data) {
  const canvas = box.querySelector("canvas"), pen = canvas.getContext("2d");
  const [button, slider, clock] = [box.querySelector("button"), box.querySelector("input"), box.querySelector("output")];
  const count = Math.max(...data.arms.map(arm => arm.frames.length)), base = data.arms[0].frames[0][0];
  const every = data.path.concat(...data.arms.flatMap(arm => arm.frames.filter((_, i) => i % 5 === 0)), [base]);
  const bounds = [0, 1, 2].map(axis => every.reduce(([low, high], p) => [Math.min(low, p[axis]), Math.max(high, p[axis])], [Infinity, -Infinity]));
  const floor = grid(), shown = every.concat(...floor);
  let turn = data.turn, tilt = data.tilt, scale = 1, shift = [0, 0], playing = true, time = 0, last = null, held = null;
  slider.max = count - 1;

  function flat([x, y, z]) {
    const across = Math.cos(turn) * x - Math.sin(turn) * y, away = Math.sin(turn) * x + Math.cos(turn) * y;
    return [across, -Math.cos(tilt) * z - Math.sin(tilt) * away];
  }
  function place(point) {
    return flat(point).map((value, i) => value * scale + shift[i]);
  }
  function fit() {  // all that is ever shown fills the canvas
    const seen = shown.map(flat), room = [canvas.width, canvas.height];
    const ends = [0, 1].map(i => [Math.min(...seen.map(p => p[i])), Math.max(...seen.map(p => p[i]))]);
    scale = Math.min(...ends.map(([low, high], i) => (room[i] - 40) / Math.max(high - low, 1e-9)));
    shift = ends.map(([low, high], i) => room[i] / 2 - scale * (low + high) / 2);
  }
  function grid() {  // lines through the base, on the floor of an arm in space, in the plane of another
    const lines = [], [x, y] = bounds.map(([low, high], i) => [low, high].map((end, j) => base[i] + data.grid * (j ? Math.ceil : Math.floor)((end - base[i]) / data.grid - 1e-6)));
    for (let a = x[0]; a <= x[1] + 1e-9; a += data.grid) lines.push([[a, y[0], base[2]], [a, y[1], base[2]]]);
    for (let b = y[0]; b <= y[1] + 1e-9; b += data.grid) lines.push([[x[0], b, base[2]], [x[1], b, base[2]]]);
    return lines;
  }
  function line(points, colour, width, strength) {
    pen.globalAlpha = strength; pen.strokeStyle = colour; pen.lineWidth = width; pen.lineJoin = "round"; pen.lineCap = "round"; pen.beginPath();
    points.forEach((point, i) => { const [a, b] = place(point); i ? pen.lineTo(a, b) : pen.moveTo(a, b); });
    pen.stroke(); pen.globalAlpha = 1;
  }
  function dot(point, colour, size) {
    const [a, b] = place(point);
    pen.fillStyle = colour; pen.beginPath(); pen.arc(a, b, size, 0, 2 * Math.PI); pen.fill();
  }
  function draw() {
    const frame = Math.min(count - 1, Math.floor(time));
    pen.fillStyle = "#ffffff"; pen.fillRect(0, 0, canvas.width, canvas.height);
    for (const points of floor) line(points, "#dfe2e7", 1, 1);
    line(data.path, data.pathColour, 7, 0.35);
    for (const arm of data.arms) {
      const now = Math.min(frame, arm.frames.length - 1), pose = arm.frames[now];
      line(arm.frames.slice(Math.max(0, now - 2 * data.rate), now + 1).map(points => points[points.length - 1]), arm.colour, 2, 0.7);
      line(pose, arm.colour, 6, 0.9);
      pose.slice(0, -1).forEach(point => dot(point, "#1a1a1a", 4));
      dot(pose[pose.length - 1], arm.colour, 7);
    }
    slider.value = frame; clock.textContent = (frame / data.rate).toFixed(2) + " s";
  }
  function step(now) {
    if (playing && last !== null) { time += (now - last) / 1000 * data.rate; if (time >= count) time = 0; }
    last = now; draw(); requestAnimationFrame(step);
  }
  button.onclick = () => { playing = !playing; button.textContent = playing ? "pause" : "play"; };
  slider.oninput = () => { time = +slider.value; playing = false; button.textContent = "play"; };
  if (data.spatial) {
    canvas.style.cursor = "grab"; canvas.style.touchAction = "none";
    canvas.onpointerdown = event => { held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); };
    canvas.onpointermove = event => {
      if (!held) return;
      turn -= (event.clientX - held[0]) * 0.008; tilt = Math.max(-1.5, Math.min(1.5, tilt + (event.clientY - held[1]) * 0.008));
      held = [event.clientX, event.clientY]; fit();
    };
    canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
  }
  fit(); requestAnimationFrame(step);
}
