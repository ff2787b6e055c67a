function play(box, data) {
  const canvas = box.querySelector("canvas"), pen = canvas.getContext("2d");
  const [button, slider, clock] = [box.querySelector("button"), box.querySelector("input"), box.querySelector("span")];
  const count = Math.max(...data.arms.map(arm => arm.frames.length));
  const every = data.path.concat(...data.arms.flatMap(arm => arm.frames)).concat([[0, 0, 0]]);
  const range = axis => { let low = Infinity, high = -Infinity; for (const p of every) { low = Math.min(low, p[axis]); high = Math.max(high, p[axis]); } return [low, high]; };
  const bounds = [range(0), range(1), range(2)], middle = bounds.map(([low, high]) => (low + high) / 2);
  const size = Math.max(...bounds.map(([low, high]) => high - low), 1e-9);
  let turn = data.spatial ? 0.9 : 0, tilt = data.spatial ? 0.35 : Math.PI / 2, playing = true, time = 0, last = null, held = null;
  slider.max = count - 1;

  function place(point) {
    const [x, y, z] = point.map((value, axis) => (value - middle[axis]) / size);
    const across = Math.cos(turn) * x - Math.sin(turn) * y, away = Math.sin(turn) * x + Math.cos(turn) * y;
    const scale = 0.8 * Math.min(canvas.width, canvas.height) / (data.spatial ? 1.25 : 1);
    return [canvas.width / 2 + scale * across, canvas.height / 2 - scale * (Math.cos(tilt) * z + Math.sin(tilt) * away)];
  }
  function line(points, colour, width) {
    pen.strokeStyle = colour; pen.lineWidth = width; pen.lineJoin = "round"; pen.lineCap = "round"; pen.beginPath();
    points.forEach((point, i) => { const [a, b] = place(point); i ? pen.lineTo(a, b) : pen.moveTo(a, b); });
    pen.stroke();
  }
  function draw() {
    const frame = Math.min(count - 1, Math.floor(time));
    pen.fillStyle = "#ffffff"; pen.fillRect(0, 0, canvas.width, canvas.height);
    pen.globalAlpha = 0.35; line(data.path, data.pathColour, 7); pen.globalAlpha = 1;
    for (const arm of data.arms) {
      const now = Math.min(frame, arm.frames.length - 1), pose = arm.frames[now];
      pen.globalAlpha = 0.6; line(arm.frames.slice(Math.max(0, now - 2 * data.rate), now + 1).map(points => points[points.length - 1]), arm.colour, 1.5); pen.globalAlpha = 1;
      line(pose, arm.colour, 6);
      for (const point of pose) { const [a, b] = place(point); pen.fillStyle = "#1a1a1a"; pen.beginPath(); pen.arc(a, b, 4, 0, 2 * Math.PI); pen.fill(); }
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
    canvas.onpointerdown = event => { held = [event.clientX, event.clientY]; canvas.setPointerCapture(event.pointerId); };
    canvas.onpointermove = event => { if (held) { turn -= (event.clientX - held[0]) * 0.008; tilt = Math.max(-1.5, Math.min(1.5, tilt + (event.clientY - held[1]) * 0.008)); held = [event.clientX, event.clientY]; } };
    canvas.onpointerup = () => { held = null; };
  }
  requestAnimationFrame(step);
}
