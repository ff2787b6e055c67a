"use strict";
const D = JSON.parse(document.getElementById("data").textContent);
const $ = id => document.getElementById(id);
const N = D.rows, H = D.step, P = D.outputs;
const FIRST = Object.fromEntries(D.sliders.map(s => [s.key, s.value]));
let v = { ...FIRST }, learn = true, shown = 0, X, M, last, noise, waiting = 0, idle = 0;
const span = (N - 1) * H;

/* ---- numbers that the sliders move */
function params() {
  const p = D.params.slice();
  for (const s of D.sliders) {
    const x = s.key === "gamma" && !learn ? 0 : v[s.key];
    for (const [i, b, c] of s.moves) p[i] += b * (x - s.value) + c * (x * x - s.value * s.value);
  }
  return p;
}
const speed = () => "speed" in v ? v.speed / FIRST.speed : 1;
const edge = side => { const k = P > 1 ? side + (shown + 1) : side; return v[k]; };

/* ---- the state and the input that belong to the reference: A X + B U = z X, C X = R of each sine */
function solved(zr, zi, Rs, Rc) {
  const { A, B, C } = D.model, n = A.length, m = B[0].length, size = n + m;
  const a = [];
  for (let i = 0; i < n; i++) {
    const row = [...A[i], ...B[i]].map(x => [x, 0]);
    row[i] = [row[i][0] - zr, -zi];
    a.push([...row, [0, 0]]);
  }
  C.forEach((c, i) => a.push([...[...c, ...Array(m).fill(0)].map(x => [x, 0]), [Rs[i], Rc[i]]]));
  const norm = x => x[0] * x[0] + x[1] * x[1];
  for (let k = 0; k < size; k++) {
    let best = k;
    for (let i = k + 1; i < size; i++) if (norm(a[i][k]) > norm(a[best][k])) best = i;
    [a[k], a[best]] = [a[best], a[k]];
    const [pr, pi] = a[k][k], q = norm(a[k][k]);
    for (let j = k; j <= size; j++) {
      const [r, s] = a[k][j];
      a[k][j] = [(r * pr + s * pi) / q, (s * pr - r * pi) / q];
    }
    for (let i = 0; i < size; i++) {
      const [fr, fi] = a[i][k];
      if (i === k || !(fr || fi)) continue;
      for (let j = k; j <= size; j++) {
        const [r, s] = a[k][j];
        a[i][j] = [a[i][j][0] - fr * r + fi * s, a[i][j][1] - fr * s - fi * r];
      }
    }
  }
  return a.map(row => row[size]);
}
function gains(signal, factor, model) {
  const T = signal.gains.map(row => row.slice());
  if (!model || factor === 1 || !signal.omegas) return T;
  const q = D.tracked;
  signal.omegas.forEach((omega, j) => {
    const w = omega * factor;
    const [zr, zi] = D.sampled ? [(Math.cos(w * H) - 1) / H, Math.sin(w * H) / H] : [0, w];
    const Rs = T.slice(0, q).map(row => row[2 * j]), Rc = T.slice(0, q).map(row => row[2 * j + 1]);
    solved(zr, zi, Rs, Rc).forEach(([s, c], i) => { T[q + i][2 * j] = s; T[q + i][2 * j + 1] = c; });
  });
  return T;
}
const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
function lines(signal) {
  const m = signal.channels, knots = new Float64Array(bytes(signal.knots).buffer);
  return (t, at) => {
    const k = Math.floor(t / H), share = t / H - k;
    for (let i = 0; i < m; i++) {
      const first = knots[k * m + i], last = knots[(k + 1) * m + i];
      M[at + i] = first + share * (last - first);
    }
  };
}
function source(signal, factor, model) {
  if (signal.knots) return lines(signal);
  const T = gains(signal, factor, model), rows = T.length, size = T[0].length, flat = Float64Array.from(T.flat());
  const w = new Float64Array(size), omegas = (signal.omegas || []).map(omega => omega * factor);
  function pieces(t) {
    let s = factor * t, k = 0;
    if (signal.period) s -= signal.period * Math.floor(s / signal.period);
    while (k + 1 < signal.starts.length && signal.starts[k + 1] <= s) k++;
    const value = signal.values[k], half = size / signal.order;
    for (let i = 0; i < size; i++) {
      const slope = i < half && signal.order > 1 ? value[half + i] * (s - signal.starts[k]) : 0;
      w[i] = (value[i] + slope) * (i < half ? 1 : factor);
    }
  }
  function sines(t) {
    for (let j = 0; j < omegas.length; j++) {
      w[2 * j] = Math.sin(omegas[j] * t);
      w[2 * j + 1] = Math.cos(omegas[j] * t);
    }
    if (signal.offset) w[size - 1] = 1;
  }
  const state = signal.omegas ? sines : pieces;
  return (t, at) => {
    state(t);
    for (let i = 0, k = 0; i < rows; i++) {
      let sum = 0;
      for (let j = 0; j < size; j++) sum += flat[k++] * w[j];
      M[at + i] = sum;
    }
  };
}

/* ---- the run */
function normal(count) {
  const g = new Float64Array(count);
  let a = 20240229;
  const uniform = () => {
    a = (a + 0x6d2b79f5) | 0;
    let t = Math.imul(a ^ (a >>> 15), 1 | a);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return (((t ^ (t >>> 14)) >>> 0) + 0.5) / 4294967296;
  };
  for (let k = 0; k < count; k++) g[k] = Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform());
  return g;
}
function run() {
  const L = D.memory, I = D.instant, instants = D.sampled ? [0] : [1e-9, 0.5, 1 - 1e-9], states = D.start.length;
  const target = source(D.reference, speed(), true), disturbed = D.disturbance ? source(D.disturbance, 1, false) : null;
  noise ??= normal(2 * N * P);
  const R = {}, kept = [], from = [];
  for (const [name, place] of Object.entries(D.recorded)) {
    kept.push(R[name] = new Float64Array(N).fill(NaN));
    from.push(L.o + place + shown);
  }
  M.fill(0);
  M.set(D.start, L.s);
  M.set(params(), L.p);
  for (let k = 0; k < N; k++) {
    for (let j = 0; j < instants.length; j++) {
      const t = (k + instants[j]) * H, at = L.w + j * I.size;
      target(t, at);
      if (disturbed) disturbed(D.sampled ? t + H / 2 : t, at + I.w);
      for (let i = 0; i < P; i++) {
        M[at + I.before + i] = noise[2 * (k * P + i)];
        M[at + I.after + i] = noise[2 * (k * P + i) + 1];
      }
    }
    X.step();
    if (D.rare && M[L.flag]) X.rare();
    for (let f = 0; f < kept.length; f++) kept[f][k] = M[from[f]];
    for (let i = 0; i < states; i++) M[L.s + i] = M[L.n + i];
    if (!(Math.abs(R.z[k]) < 1e9)) break;
  }
  return R;
}

/* ---- what came of it: rms over the second half */
function measured(R) {
  let silent = 0, y = 0, e = 0, right = 0, left = 0, most = 0;
  const half = N >> 1;
  for (let k = 0; k < N; k++) {
    if (R.side[k] > 0) right++;
    if (R.side[k] < 0) left++;
    most = Math.max(most, Math.abs(R.z[k]));
    if (k < half) continue;
    silent += R.side[k] === 0;
    y += (R.y[k] / D.slope[shown] - R.z[k]) ** 2;
    e += (R.z_hat[k] - R.z[k]) ** 2;
  }
  const count = N - half, end = N - 1;
  return {
    silent: silent / count, sensor: Math.sqrt(y / count), observer: Math.sqrt(e / count),
    onRight: right, onLeft: left, most, right: R.right[end], left: R.left[end], z: R.z[end], z_hat: R.z_hat[end],
  };
}
const short = x => x === 0 ? "0" : x >= 100 ? x.toFixed(0) : x >= 1e-4 ? String(+x.toPrecision(2)) : x.toExponential(0);
const unit = D.unit === "1" ? "" : " " + D.unit;
function sentence(m) {
  const b = (text, c) => ({ text, c });
  if (!isFinite(m.observer) || !isFinite(m.most)) return ["This does not settle: the loop runs away. Take a smaller learning gain or a slower motion."];
  if (m.silent > 0.995) return [D.words.never, b("nothing can be learnt"), " of the edges, by this observer or any other, but that they lie further out. Make the motion larger or the band narrower."];
  const share = m.silent > 0 && m.silent < 0.01 ? "less than 1 %" : `${(100 * m.silent).toFixed(0)} %`;
  const ratio = m.sensor / m.observer, say = [D.words.silent, b(share), " of the time. "];
  if (!(m.sensor > 0)) return [...say, `There is no ${D.words.zone}: the sensor tells the truth.`];
  say.push("Believing the sensor is wrong by ", b(short(m.sensor) + unit, "y"), "; the observer, by ", b(short(m.observer) + unit, "e"), ": ");
  if (ratio >= 1.05) say.push(b(ratio > 1e4 ? "more than 10 000 times" : `${ratio >= 10 ? ratio.toFixed(0) : ratio.toFixed(1)} times`), " better.");
  else say.push("no better.");
  if (D.learns && !learn) say.push(" Learning is off: it keeps its first guess of the band.");
  else if (!m.onRight || !m.onLeft) say.push(` The motion never passes the ${m.onRight ? "left" : "right"} edge, so that number is a guess.`);
  return say;
}
function write(element, parts) {
  element.textContent = "";
  for (const part of parts) {
    if (typeof part === "string") { element.append(part); continue; }
    const bold = document.createElement("b");
    bold.textContent = part.text;
    if (part.c) bold.className = part.c;
    element.append(bold);
  }
}

/* ---- drawing */
function colours() {
  const style = getComputedStyle(document.documentElement);
  return name => style.getPropertyValue("--" + name).trim();
}
function nice(x) {
  const e = 10 ** Math.floor(Math.log10(x));
  return [1, 2, 5, 10].find(f => f * e >= x * 0.999) * e;
}
function axes(id, lo, hi, t0, t1, title) {
  const canvas = $(id), d = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  canvas.width = Math.round(w * d); canvas.height = Math.round(h * d);
  const g = canvas.getContext("2d"), col = colours(), L = 46, R = 8, T = 20, B = 20;
  g.scale(d, d);
  const x = t => L + (w - L - R) * (t - t0) / (t1 - t0), y = z => T + (h - T - B) * (hi - z) / (hi - lo);
  g.font = "12px system-ui, sans-serif"; g.lineWidth = 1;
  const dz = nice((hi - lo) / (h / 48)), dt = nice((t1 - t0) / (w / 90));
  g.textAlign = "right";
  for (let i = Math.ceil(lo / dz); i * dz <= hi; i++) {
    g.strokeStyle = col(i ? "line" : "soft");
    g.beginPath(); g.moveTo(L, y(i * dz)); g.lineTo(w - R, y(i * dz)); g.stroke();
    g.fillStyle = col("soft"); g.fillText(String(+(i * dz).toFixed(6)), L - 6, y(i * dz) + 4);
  }
  for (let i = Math.ceil(t0 / dt - 1e-9); i * dt <= t1 * (1 + 1e-9); i++) {
    const near = x(i * dt) > w - 30;
    g.textAlign = near ? "right" : "center";
    g.fillText(`${+(i * dt).toFixed(6)} s`, near ? w - R : x(i * dt), h - 5);
  }
  g.textAlign = "left"; g.fillText(title, L, 13);
  return { g, col, x, y, w, h, L, R, T, B, t0, t1 };
}
function band(c, right, left) {
  const { g, col, x, y, w, L, R } = c;
  g.globalAlpha = 0.28; g.fillStyle = col("zone");
  g.fillRect(L, y(right), w - L - R, y(-left) - y(right));
  g.globalAlpha = 1; g.strokeStyle = col("zone"); g.lineWidth = 1.5;
  for (const z of [right, -left]) { g.beginPath(); g.moveTo(L, y(z)); g.lineTo(w - R, y(z)); g.stroke(); }
}
function carried(c, values, right, left) {
  const { g, col, x, y } = c, stride = Math.max(1, Math.floor((c.t1 - c.t0) / H / (2 * c.w)));
  const a = Math.max(0, Math.floor(c.t0 / H)), b = Math.min(N - 1, Math.ceil(c.t1 / H));
  g.save(); g.beginPath(); g.rect(c.L, c.T - 4, c.w - c.L - c.R, c.h - c.T - c.B + 8); g.clip();
  g.beginPath();
  for (let k = a; k <= b; k += stride) g.lineTo(x(k * H), y(values[k] + right));
  for (let k = b; k >= a; k -= stride) g.lineTo(x(k * H), y(values[k] - left));
  g.globalAlpha = 0.28; g.fillStyle = col("zone"); g.fill(); g.restore();
}
function curve(c, values, name, width, dash, sign = 1) {
  const { g, col, x, y } = c, a = Math.max(0, Math.floor(c.t0 / H)), b = Math.min(N - 1, Math.ceil(c.t1 / H));
  const stride = Math.max(1, Math.floor((b - a) / (2 * (c.w - c.L - c.R))));
  g.save(); g.beginPath(); g.rect(c.L, c.T - 4, c.w - c.L - c.R, c.h - c.T - c.B + 8); g.clip();
  g.strokeStyle = col(name); g.lineWidth = width; g.setLineDash(dash || []); g.lineJoin = "round";
  g.beginPath();
  for (let k = a, on = false; k <= b; k += stride) {
    const seen = values[k] === values[k];
    if (seen) g[on ? "lineTo" : "moveTo"](x(k * H), y(sign * values[k]));
    on = seen;
  }
  g.stroke(); g.restore();
}
function label(c, text, t, z, name, below, align) {
  const { g, col, x, y } = c;
  g.font = "600 12.5px system-ui, sans-serif"; g.textAlign = align || "left";
  const width = g.measureText(text).width + 8, px = x(t) + (align === "right" ? -8 : 8), py = y(z) + (below ? 16 : -7);
  g.globalAlpha = 0.78; g.fillStyle = col("card"); g.fillRect(px - (align === "right" ? width - 4 : 4), py - 12, width, 16);
  g.globalAlpha = 1; g.fillStyle = col(name); g.fillText(text, px, py);
}
function doubt(c, values, std, sign) {
  const { g, col, x, y } = c, stride = Math.max(1, Math.floor(N / 400));
  g.beginPath();
  for (let k = 0; k < N; k += stride) g.lineTo(x(k * H), y(sign * (values[k] + 2 * std[k])));
  for (let k = N - 1; k >= 0; k -= stride) g.lineTo(x(k * H), y(sign * Math.max(0, values[k] - 2 * std[k])));
  g.save(); g.clip();
  g.globalAlpha = 0.2; g.fillStyle = col("e"); g.fillRect(c.L, c.T - 4, c.w - c.L - c.R, c.h - c.T - c.B + 8);
  g.restore();
}
function draw(R, m) {
  const right = edge("right"), left = edge("left");
  const room = $("motion").clientWidth - 54, period = D.period ? D.period / speed() : span;
  const most = Math.max(3, Math.floor(room / 42)), length = Math.min(span, most * period);
  const from = length < span * 0.999 ? Math.min(window.from ?? 0, span - length) : 0;
  let top = Math.max(right, left) * 1.15, peak = 0.001;
  for (let k = 0; k < N; k++) {
    peak = Math.max(peak, Math.abs(R.z[k]) || 0);
    const e = Math.abs(R.z_hat[k]);
    if (e < 3 * peak) top = Math.max(top, e);
  }
  top = Math.min(Math.max(top, peak), 1e9) * 1.08;
  const a = axes("motion", -top, top, from, from + length, D.quantity);
  const reading = R.y.map(y => y / D.slope[shown]);
  if (D.kind === "play") carried(a, reading, right, left);
  else band(a, right, left);
  curve(a, R.z, "z", 5);
  curve(a, R.z_hat, "e", 2.6, [6, 3]);
  curve(a, reading, "y", 2.2);
  curve(a, reading.map((y, k) => (R.side[k] ? NaN : y)), "y", 4.5);
  const high = Math.max(right, left, 0.2 * peak) * 1.75;
  const b = axes("edges", -high, high, 0, span, `what the observer believes the ${D.words.zone} to be`);
  band(b, right, left);
  for (const [side, sign] of [["right", 1], ["left", -1]]) if (R[side + "_std"]) doubt(b, R[side], R[side + "_std"], sign);
  curve(b, R.right, "e", 2.8, null, 1);
  curve(b, R.left, "e", 2.8, null, -1);
  const number = x => (x > 0 && x < 0.1 ? x.toPrecision(3) : x.toFixed(3));
  function learned(side, passed, width) {
    const std = R[side + "_std"], plus = std ? ` ± ${short(2 * std[N - 1])}` : "", truth = `(true ${+width.toFixed(4)})`;
    return passed ? `${side} edge learned: ${number(m[side])}${plus} ${truth}` : `${side} edge never passed ${truth}`;
  }
  if (D.kind === "play" && R.width_std) {
    const known = `gap learned: ${number(m.right + m.left)} ± ${short(2 * R.width_std[N - 1])}`;
    label(b, `${known} (true ${+(right + left).toFixed(4)})`, span, Math.max(right, m.right), "e-ink", false, "right");
  } else label(b, learned("right", m.onRight, right), span, Math.max(right, m.right), "e-ink", false, "right");
  if (D.kind !== "play") label(b, learned("left", m.onLeft, left), span, -Math.max(left, m.left), "e-ink", true, "right");
  if (length < span * 0.999) {
    const { g, col, x, h } = b;
    g.strokeStyle = col("ink"); g.lineWidth = 3; g.beginPath(); g.moveTo(x(from), h - 18); g.lineTo(x(from + length), h - 18); g.stroke();
  }
  $("look").hidden = !(length < span * 0.999);
  const look = $("i_look"); look.max = span - length; look.value = from;
  $("o_look").textContent = `${from.toFixed(1)} s`;
}

/* ---- one move */
function go() {
  waiting = 0;
  const t0 = performance.now(), R = run(), t1 = performance.now(), m = measured(R), said = sentence(m);
  last = { R, m };
  draw(R, m);
  write($("say"), said);
  for (const s of D.sliders) {
    $("i_" + s.key).value = v[s.key];
    const text = `${+v[s.key].toPrecision(4)}${s.unit ? " " + s.unit : ""}`;
    $("o_" + s.key).textContent = text;
    $("i_" + s.key).setAttribute("aria-valuetext", text);
  }
  $("learn").textContent = learn ? "Learning: on" : "Learning: off";
  $("learn").setAttribute("aria-pressed", learn);
  $("cost").textContent = `${N.toLocaleString("en")} steps took ${(t1 - t0).toFixed(1)} ms.`;
  document.documentElement.dataset.numbers = JSON.stringify(m);
  clearTimeout(idle);
  idle = setTimeout(settled, 500);
}
function settled() {
  const text = $("say").textContent;
  $("heard").textContent = text;
  $("motion").setAttribute("aria-label", `Motion over time: truth, reading and estimate. ${text}`);
  $("edges").setAttribute("aria-label", `Learned edges over time: right ${last.m.right.toFixed(3)}, left ${last.m.left.toFixed(3)}.`);
  try { history.replaceState(null, "", "#" + link()); } catch (e) { /* a page that may not: the button still copies */ }
}
const later = () => { if (X) waiting ||= requestAnimationFrame(go); };

/* ---- the link */
function link() {
  const q = new URLSearchParams();
  for (const s of D.sliders) q.set(s.key, String(+v[s.key].toPrecision(6)));
  if (D.learns) q.set("learn", learn ? "1" : "0");
  if (P > 1) q.set("output", String(shown + 1));
  return q.toString();
}
function load() {
  v = { ...FIRST }; learn = true;
  const q = new URLSearchParams(location.hash.slice(1, 2000));
  for (const s of D.sliders) {
    const text = q.get(s.key), x = Number(text);
    if (text !== null && text.trim() !== "" && Number.isFinite(x)) v[s.key] = Math.min(s.most, Math.max(s.least, x));
  }
  if (D.learns && q.get("learn") === "0") learn = false;
  const output = Number(q.get("output"));
  if (Number.isInteger(output) && output >= 1 && output <= P) shown = output - 1;
}
function control(key, text, least, most, step, change) {
  const div = document.createElement("div"), l = document.createElement("label"), o = document.createElement("output"), i = document.createElement("input");
  div.className = "control";
  l.htmlFor = i.id = "i_" + key; o.id = "o_" + key; o.htmlFor = i.id;
  i.type = "range"; i.min = least; i.max = most; i.step = step;
  i.oninput = () => { change(+i.value); later(); };
  l.append(text, o); div.append(l, i); $("sliders").append(div);
  return div;
}
function build() {
  write($("lead"), [D.lead]);
  write($("note"), [D.note]);
  if (P > 1) {
    const select = document.createElement("select"), l = document.createElement("label"), div = document.createElement("div");
    for (let i = 0; i < P; i++) select.append(new Option(`output ${i + 1}`, i));
    l.append("look at ", select); div.className = "control"; div.append(l); $("sliders").append(div);
    select.value = shown; select.id = "output";
    select.onchange = () => { shown = +select.value; later(); };
  }
  for (const s of D.sliders) control(s.key, s.label, s.least, s.most, s.grid, x => { v[s.key] = x; });
  control("look", "look from", 0, span, "any", x => { window.from = x; }).id = "look";
  $("learn").hidden = !D.learns;
  $("learn").onclick = () => { learn = !learn; later(); };
  $("again").onclick = () => { v = { ...FIRST }; learn = true; later(); };
  $("share").onclick = async () => {
    const said = text => { $("share").textContent = text; setTimeout(() => { $("share").textContent = "Copy a link to this"; }, 2500); };
    settled();
    try { await navigator.clipboard.writeText(location.href); said("Copied"); } catch (e) { said("It is in the address bar"); }
  };
  addEventListener("resize", later);
  addEventListener("hashchange", () => { load(); later(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", later);
}
load();
build();
WebAssembly.instantiate(bytes(D.wasm)).then(r => {
  X = r.instance.exports;
  M = new Float64Array(X.memory.buffer);
  go();
}, () => write($("say"), ["This browser does not run WebAssembly, which this page needs."]));
