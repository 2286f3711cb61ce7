/* Every eigenvalue of the loop in sight, with exact delay, and the proof that none is missing.
 *
 * Plant G(s) and controller K(s) come in modal form; with E(s) = diag(exp(-s tau)) the roots are those of
 * F(s) = det(sI - A) det(sI - A_K) det(I - K E G). Aberth's iteration finds all at once; the argument
 * principle along the box in sight counts them. Complex numbers are pairs [re, im]. */
'use strict';

const cMul = (a, b) => [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]];
const cAdd = (a, b) => [a[0] + b[0], a[1] + b[1]];
const cSub = (a, b) => [a[0] - b[0], a[1] - b[1]];
const cInv = (a) => {
  const m = a[0] * a[0] + a[1] * a[1];
  return [a[0] / m, -a[1] / m];
};
const cDiv = (a, b) => cMul(a, cInv(b));
const cAbs = (a) => Math.hypot(a[0], a[1]);

const SETTLED = 1e-7;     /* 1/s: the last move of a root that is shown */
const SEEDS = 10;         /* roots that delay brings in from the left */

/* Sum of products of complex numbers in flat arrays. */
function product(a, b) {
  let re = 0, im = 0;
  for (let j = 0; j < a.length; j += 2) {
    re += a[j] * b[j] - a[j + 1] * b[j + 1];
    im += a[j] * b[j + 1] + a[j + 1] * b[j];
  }
  return [re, im];
}

/* Modal form with the conjugates filled in; complex rows in flat arrays, [re, im, re, im ...]. */
class Modal {
  constructor({ poles, c, b, d }, inputScale) {
    const upper = poles.map((_, j) => j), lower = upper.filter((j) => poles[j][1] > 0);
    const both = (row) => [...upper.map((j) => row[j]), ...lower.map((j) => [row[j][0], -row[j][1]])];
    const scale = (i) => (inputScale ? inputScale[i] : 1);
    this.poles = both(poles);
    this.c = c.map((row) => Float64Array.from(both(row).flat()));
    this.b = b.map((row, i) => both(row).map(([re, im]) => [re * scale(i), im * scale(i)]));
    this.residues = c.map((row) => this.b.map((own) => Float64Array.from(both(row).flatMap((z, j) => cMul(z, own[j])))));
    this.d = d.map((row) => row.map((x, i) => x * scale(i)));
    this.inverse = new Float64Array(2 * this.poles.length);
    this.square = new Float64Array(2 * this.poles.length);
  }

  /* Values at s for these outputs and inputs, [output][input] of [re, im, re', im']; the derivatives where `slopes`. */
  at(s, outputs, inputs, slopes) {
    const g = this.inverse, h = this.square;                      /* 1 / (s - l), and its derivative */
    for (let j = 0; j < g.length; j += 2) {
      const l = this.poles[j / 2], x = s[0] - l[0], y = s[1] - l[1], m = x * x + y * y, re = x / m, im = -y / m;
      g[j] = re;
      g[j + 1] = im;
      h[j] = im * im - re * re;
      h[j + 1] = -2 * re * im;
    }
    return outputs.map((o) => inputs.map((i) => {
      const r = this.residues[o][i], [re, im] = product(r, g), [byRe, byIm] = slopes ? product(r, h) : [0, 0];
      return [this.d[o][i] + re, im, byRe, byIm];
    }));
  }

  /* These outputs at s where the inputs move by u. */
  moved(s, outputs, inputs, u) {
    const modes = this.poles.flatMap((l, j) => cDiv(inputs.reduce((z, i, k) => cAdd(z, cMul(this.b[i][j], u[k])), [0, 0]), cSub(s, l)));
    return outputs.map((o) => cAdd(product(this.c[o], modes), inputs.reduce((z, i, k) => cAdd(z, cMul([this.d[o][i], 0], u[k])), [0, 0])));
  }
}

/* Sum of 1 / (s - z) over the places z; `own`: what one at s counts. */
function inverses(s, places, own) {
  let re = 0, im = 0;
  for (let j = 0; j < places.length; ++j) {
    const z = places[j], x = s[0] - z[0], y = s[1] - z[1], m = x * x + y * y;
    if (m > 0) {
      re += x / m;
      im -= y / m;
    } else re += own;
  }
  return [re, im];
}

/* Determinant of a small complex matrix and the solution of M X = R, by elimination with pivots. */
function eliminate(M, R) {
  const n = M.length;
  let det = [1, 0];
  for (let k = 0; k < n; ++k) {
    let p = k;
    for (let i = k + 1; i < n; ++i) if (cAbs(M[i][k]) > cAbs(M[p][k])) p = i;
    if (p !== k) {
      [M[p], M[k]] = [M[k], M[p]];
      if (R) [R[p], R[k]] = [R[k], R[p]];
      det = [-det[0], -det[1]];
    }
    det = cMul(det, M[k][k]);
    for (let i = k + 1; i < n; ++i) {
      const f = cDiv(M[i][k], M[k][k]);
      for (let j = k; j < n; ++j) M[i][j] = cSub(M[i][j], cMul(f, M[k][j]));
      if (R) for (let j = 0; j < R[i].length; ++j) R[i][j] = cSub(R[i][j], cMul(f, R[k][j]));
    }
  }
  if (R) {
    for (let k = n - 1; k >= 0; --k) {
      for (let j = 0; j < R[k].length; ++j) {
        for (let i = k + 1; i < n; ++i) R[k][j] = cSub(R[k][j], cMul(M[k][i], R[i][j]));
        R[k][j] = cDiv(R[k][j], M[k][k]);
      }
    }
  }
  return det;
}

class Loop {
  constructor(plant, point, controller, chosen, signals, edge) {
    this.edge = edge;
    this.plant = plant;
    this.controller = controller;
    this.point = point;
    this.signals = signals;             /* {input of the controller, output of the plant, tau} */
    this.actuators = chosen ? chosen.outputs.map((u) => point.actuators.indexOf(u)) : [];
    this.open = chosen === null || signals.length === 0;
    this.poles = this.open ? plant.poles : [...plant.poles, ...controller.poles];
  }

  /* Plant and controller at s. */
  values(s, slopes) {
    const { plant, controller, signals } = this;
    return [plant.at(s, signals.map((x) => x.output), this.actuators, slopes),
      controller.at(s, controller.c.map((_, o) => o), signals.map((x) => x.input), slopes)];
  }

  /* I - K E G at s; where `slopes` its derivatives by s and by a common factor on every latency. */
  matrices(s, slopes, values = this.values(s, slopes)) {
    const [G, K] = values, p = this.actuators.length, M = [], Ms = [], Mt = [];
    const delays = this.signals.map(({ tau }) => {
      const size = Math.exp(-s[0] * tau);
      return [size * Math.cos(s[1] * tau), -size * Math.sin(s[1] * tau)];
    });
    for (let i = 0; i < p; ++i) {
      const late = delays.map((e, q) => cMul(e, K[i][q]));
      M.push([]);
      Ms.push([]);
      Mt.push([]);
      for (let j = 0; j < p; ++j) {
        let re = i === j ? 1 : 0, im = 0, w = [0, 0], t = [0, 0];
        for (let q = 0; q < late.length; ++q) {
          const k = late[q], g = G[q][j], { tau } = this.signals[q];
          const kr = k[0] * g[0] - k[1] * g[1], ki = k[0] * g[1] + k[1] * g[0];
          re -= kr;
          im -= ki;
          if (!slopes) continue;
          const turned = cMul(delays[q], [K[i][q][2], K[i][q][3]]);
          w = cSub(w, cAdd(cAdd(cMul(turned, g), cMul(k, [g[2], g[3]])), [-tau * kr, -tau * ki]));
          t = cAdd(t, cMul(s, [tau * kr, tau * ki]));
        }
        M[i].push([re, im]);
        Ms[i].push(w);
        Mt[i].push(t);
      }
    }
    return [M, Ms, Mt];
  }

  /* Its determinant; what it takes of plant and controller there is kept: latencies do not move it. */
  det(s, place) {
    if (!this.edge.has(place)) this.edge.set(place, this.values(s, false));
    return eliminate(this.matrices(s, false, this.edge.get(place))[0], null);
  }

  /* F'/F at s, and that of det(I - K E G) by the common factor. */
  slopes(s) {
    let sum = inverses(s, this.poles, NaN), byFactor = [0, 0];
    if (!this.open) {
      const [M, Ms, Mt] = this.matrices(s, true), p = M.length;
      const R = Ms.map((row, i) => [...row, ...Mt[i]]);
      eliminate(M, R);
      for (let i = 0; i < p; ++i) {
        sum = cAdd(sum, R[i][i]);
        byFactor = cAdd(byFactor, R[i][p + i]);
      }
    }
    return [sum, byFactor];
  }

  /* The speeds of the machines in the motion of root s, the largest being 1 with angle 0. */
  shape(s, machines) {
    let x;
    if (this.open) {
      let near = 0;
      this.plant.poles.forEach((l, j) => {
        if (cAbs(cSub(s, l)) < cAbs(cSub(s, this.plant.poles[near]))) near = j;
      });
      x = machines.map((o) => [this.plant.c[o][2 * near], this.plant.c[o][2 * near + 1]]);
    } else {
      x = this.plant.moved(s, machines, this.actuators, this.nullVector(s));
    }
    let most = [0, 0];
    for (const z of x) if (cAbs(z) > cAbs(most)) most = z;
    return cAbs(most) > 0 ? x.map((z) => cDiv(z, most)) : x;
  }

  /* u with (I - K E G) u = 0: two steps of inverse iteration. */
  nullVector(s) {
    const p = this.actuators.length;
    let u = this.actuators.map((_, k) => [1, 0.1 * k]);
    if (p === 1) return u;
    const [near] = this.matrices([s[0] + 1e-9, s[1]], false);
    for (let n = 0; n < 3; ++n) {
      const R = u.map((z) => [z]);
      eliminate(near.map((row) => [...row]), R);
      const size = Math.max(...R.map((row) => cAbs(row[0])));
      u = R.map((row) => [row[0][0] / size, row[0][1] / size]);
    }
    return u;
  }
}

/* One sweep of Aberth's iteration over the roots that are not still; `near` leaves those far from the box where
 * they are. Returns how far the roots inside `box` moved. */
function sweep(loop, roots, moves, box, near) {
  let worst = 0;
  for (let k = 0; k < roots.length; ++k) {
    const s = roots[k];
    if (moves[k] < 1e-9 || (near && !inside(s, near))) continue;
    const newton = cInv(loop.slopes(s)[0]);
    const push = inverses(s, roots, 0);
    let move = cDiv(newton, cSub([1, 0], cMul(newton, push)));
    if (!Number.isFinite(move[0] + move[1])) move = [0, 0];   /* on a pole, which then is the root */
    const size = cAbs(move);
    if (size > 2) move = [move[0] * 2 / size, move[1] * 2 / size];
    roots[k] = cSub(s, move);
    moves[k] = size;
    if (inside(roots[k], box) && size > worst) worst = size;
  }
  return worst;
}

function inside(s, box) {
  return s[0] > box.left && s[0] < box.right && s[1] > box.low && s[1] < box.high;
}

/* How often `f` winds around zero along the box, counter-clockwise; null where it is not resolved. f(s, u): at the
 * place s, which is u sides from the first corner. */
function winding(f, box) {
  const corners = [[box.left, box.low], [box.right, box.low], [box.right, box.high], [box.left, box.high]];
  const at = (u) => {
    const k = Math.min(3, Math.floor(u)), a = corners[k], b = corners[(k + 1) % 4];
    return f([a[0] + (b[0] - a[0]) * (u - k), a[1] + (b[1] - a[1]) * (u - k)], u);
  };
  let total = 0, sound = true;
  const walk = (a, fa, b, fb, depth) => {
    const r = cDiv(fb, fa), turn = Math.atan2(r[1], r[0]);
    if (Math.abs(turn) < 0.7 && depth > 0) {
      total += turn;
      return;
    }
    if (depth > 24 || !Number.isFinite(turn)) {
      sound = false;
      return;
    }
    const m = (a + b) / 2, fm = at(m);
    walk(a, fa, m, fm, depth + 1);
    walk(m, fm, b, fb, depth + 1);
  };
  for (let n = 0, last = at(0); n < 96; ++n) {
    const next = at((n + 1) / 24);
    walk(n / 24, last, (n + 1) / 24, next, 0);
    last = next;
  }
  return sound ? Math.round(total / (2 * Math.PI)) : null;
}

class Eigenvalues {
  constructor(data) {
    this.data = data;
    this.stored = new Map();              /* model -> the roots as last found */
    this.modals = new Map();
  }

  modal(key, numbers, scale) {
    if (!this.modals.has(key)) this.modals.set(key, new Modal(numbers, scale));
    return this.modals.get(key);
  }

  /* The loop of a state; its latencies times `factor`. Signals that are gone for good do nothing. */
  loop(state, factor = 1) {
    const number = value(this.data, state, 'op'), point = this.data.points[number];
    if (point.modal.why) return { why: point.modal.why };
    const chosen = controllerOf(this.data, state);
    if (chosen && !chosen.modal) return { why: 'a bank of controllers has no one set of eigenvalues' };
    if (chosen && chosen.modal.why) return { why: chosen.modal.why };
    const plant = this.modal('p' + number, point.modal, null);
    let mean = false, lost = false;
    const signals = [];
    for (const channel of channelsOf(this.data, state)) {
      const table = channelTable(this.data, state, channel);
      const last = (table.outages_s || []).slice(-1)[0];
      if (last && last[1] >= this.data.stop) {
        lost = true;
        continue;
      }
      const extra = 0.5 * ((table.reporting_interval_s || 0) + (table.jitter_s || 0));
      if (table.signal_faults) return { why: 'a signal is wrong: the loop has no one set of eigenvalues' };
      mean = mean || extra > 0;
      signals.push({ input: chosen.inputs.indexOf(channel.signal), output: point.outputs.indexOf(channel.signal),
        tau: factor * ((table.latency_s || 0) + extra) });
    }
    const gain = value(this.data, state, 'g');
    let controller = null;
    if (chosen) {
      const numbers = gain === 1 ? chosen.modal
        : { ...chosen.modal, c: chosen.modal.c.map((row) => row.map((z) => [gain * z[0], gain * z[1]])),
          d: chosen.modal.d.map((row) => row.map((x) => gain * x)) };
      controller = gain === 1 ? this.modal('k' + chosen.key, numbers, chosen.scale) : new Modal(numbers, chosen.scale);
    }
    const key = number + '/' + (chosen ? chosen.key : '') + '/' + signals.map((x) => x.input).join();
    if (this.edgeOf !== key + '/' + gain) this.edge = new Map();
    this.edgeOf = key + '/' + gain;
    return { loop: new Loop(plant, point, controller, chosen, signals, this.edge), mean, lost, key };
  }

  /* What is in sight: the swing modes of this grid with room around them. */
  box(point) {
    let high = 1.35;
    for (const [re, im] of point.modal.poles)
      if (im > 0.6 && -re / Math.hypot(re, im) < 0.35) high = Math.max(high, 1.08 * im / (2 * Math.PI));
    return { left: -3.3, right: 1.05, low: 0.3, high: 2 * Math.PI * Math.min(high, 3) };
  }

  start(loop) {
    const roots = loop.poles.map((l, k) => [l[0] + 1e-3 * Math.cos(k + 1), l[1] + 1e-3 * Math.sin(k + 1)]);
    if (!loop.open)
      for (let k = 0; k < SEEDS / 2; ++k)
        for (const sign of [1, -1]) roots.push([-4 - 0.3 * k, sign * (1.2 + 2.2 * k)]);
    return roots;
  }

  solve(loop, box, roots, sweeps, warm) {
    const moves = roots.map(() => 1), near = warm ? { left: box.left - 1.5, right: box.right + 1, low: box.low - 0.15, high: box.high + 4 } : null;
    for (let n = 0; n < sweeps; ++n) if (sweep(loop, roots, moves, box, near) < SETTLED) break;
    return roots.filter((s, k) => moves[k] < SETTLED && inside(s, box));
  }

  /* {roots: [{s, shape}], open: [s], box, proven, mean, lost} or {why}. */
  of(state) {
    const { loop, mean, lost, key, why } = this.loop(state);
    if (why) return { why };
    const request = JSON.stringify([key, mean, lost, value(this.data, state, 'g'), loop.signals]);
    if (this.request !== request) this.answer = this.find(loop, mean, lost, key);
    this.request = request;
    return this.answer;
  }

  find(loop, mean, lost, key) {
    const { point } = loop, box = this.box(point);
    const open = loop.plant.poles.filter((s) => inside(s, box));
    if (loop.open) return this.result(loop, open, open, box, true, mean, lost);
    const edge = winding((s, u) => loop.det(s, u), box);
    const expected = edge === null ? null : edge + loop.poles.filter((s) => inside(s, box)).length;
    let roots = this.stored.get(key) || this.start(loop);
    let seen = this.solve(loop, box, roots, this.stored.has(key) ? 12 : 60, this.stored.has(key));
    if (seen.length !== expected) {
      roots = this.start(loop);
      seen = this.solve(loop, box, roots, 90);
    }
    if (seen.length === expected) this.stored.set(key, roots);
    else this.stored.delete(key);
    return this.result(loop, seen, open, box, seen.length === expected, mean, lost);
  }

  result(loop, roots, open, box, proven, mean, lost) {
    const machines = this.data.machines.map((m) => loop.point.outputs.indexOf(m.name + '_dw'));
    return { box, proven, mean, lost, open, exact: !loop.open,
      roots: roots.map((s) => ({ s, shape: loop.shape(s, machines) })) };
  }

  /* The roots while every latency grows from nothing to twice what it is, each step from the exact derivative. */
  async track(state, goOn) {
    const first = this.loop(state);
    if (first.why || first.loop.open || !first.loop.signals.some((x) => x.tau > 0)) return { paths: [] };
    const box = this.box(first.loop.point), stored = this.stored.get(first.key);
    if (!stored) return { paths: [] };
    const paths = [];
    for (const direction of [-1, 1]) {
      let roots = stored.filter((s) => inside(s, box)), factor = 1;
      for (let n = 0; n < 24; ++n) {
        const now = this.loop(state, factor).loop, to = factor + direction / 24, next = this.loop(state, to).loop;
        roots = roots.map((s) => {
          const [by, byFactor] = now.slopes(s), slope = cDiv(byFactor, by);
          let z = cSub(s, [slope[0] * (to - factor) / factor, slope[1] * (to - factor) / factor]);
          if (!Number.isFinite(z[0] + z[1])) z = s;
          for (let i = 0, size = 1; i < 6 && size > 1e-10; ++i) {
            const move = cInv(next.slopes(z)[0]);
            size = cAbs(move);
            if (!(size < 1)) return null;
            z = cSub(z, move);
          }
          return inside(z, box) ? z : null;
        }).filter((z) => z !== null);
        paths.push(...roots.map((z) => [z[0], z[1], to]));
        factor = to;
        if (factor < 1e-9 || (n % 6 === 5 && goOn && !(await goOn()))) break;
      }
    }
    return { paths };
  }
}
