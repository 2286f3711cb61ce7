/* What a run did, in numbers and words. Everything is read from the record, nothing from eigenvalues. */
'use strict';

const minus = (text) => String(text).replace('-', '−');
const digits = (x, n) => minus(x.toFixed(n));

/* One column of a result: a view of every `width`-th number. */
function column(result, name) {
  const k = result.columns.indexOf(name), width = result.columns.length, n = result.rows.length / width;
  if (k < 0) return null;
  const out = new Float64Array(n);
  for (let i = 0; i < n; ++i) out[i] = result.rows[i * width + k];
  return out;
}

/* Weighted sum of a machine output, such as the difference of two speeds. */
function weighted(data, result, what, scale) {
  const sum = new Float64Array(result.rows.length / result.columns.length);
  for (const [machine, weight] of Object.entries(data.swing.weights)) {
    const x = column(result, machine + '_' + what);
    for (let i = 0; i < sum.length; ++i) sum[i] += scale * weight * x[i];
  }
  return sum;
}

function span(x, from, to) {
  let low = Infinity, high = -Infinity;
  for (let i = Math.max(0, from); i < Math.min(x.length, to); ++i) {
    if (x[i] < low) low = x[i];
    if (x[i] > high) high = x[i];
  }
  return high > low ? high - low : 0;
}

/* When the first machine is half a turn away from the others; NaN where none is. */
function outOfStep(data, result) {
  const sides = weighted(data, result, 'delta', 1);
  const angles = data.machines.map((m) => column(result, m.name + '_delta'));
  for (let i = 0; i < sides.length; ++i) {
    if (Math.abs(sides[i]) > Math.PI || angles.some((x) => Math.abs(x[i]) > Math.PI)) return i * result.h;
  }
  return NaN;
}

/* {kind, t, peak}: kind is one of still, collapse, step, grows, never, settles. */
function judge(data, state, result) {
  const swing = weighted(data, result, 'dw', 1000 * data.case.frequency), { h } = result;
  const at = value(data, state, 'at'), window = Math.round(2 / h), begin = Math.round(at / h), last = Math.max(at, ...eventTables(data, state).map((e) => e.start_s));
  const lost = outOfStep(data, result);
  if (Number.isFinite(lost)) return { kind: 'step', t: lost, swing };
  if (result.why) return { kind: 'collapse', t: (swing.length - 1) * h, swing };
  let most = 0;
  const spans = [];
  for (let i = begin; i + window <= swing.length; i += Math.max(1, Math.round(0.05 / h))) {
    const p = span(swing, i, i + window);
    spans.push([i * h, p]);
    most = Math.max(most, p);
  }
  if (!(most > 0.02)) return { kind: 'still', t: 0, swing };
  const late = span(swing, swing.length - Math.round(0.15 * swing.length), swing.length);
  const middle = span(swing, Math.round(0.35 * swing.length), Math.round(0.475 * swing.length));
  if (late > 0.05 * most && late > 1.12 * middle) return { kind: 'grows', t: 0, swing };
  if (late > 0.05 * most && late > 0.8 * middle) return { kind: 'never', t: 0, swing };
  let settled = null;
  for (let k = spans.length - 1; k >= 0 && spans[k][1] <= 0.05 * most; --k) settled = spans[k][0];
  if (settled === null) return { kind: 'slow', t: data.stop, swing };
  return { kind: 'settles', t: Math.max(settled - last, 0), swing };
}

/* Least damped swing mode of the roots in sight. */
function leastDamped(roots) {
  let least = null;
  for (const { s } of roots) {
    const zeta = -s[0] / Math.hypot(s[0], s[1]);
    if (s[1] > 0.6 && (least === null || zeta < least.zeta)) least = { zeta, hertz: s[1] / (2 * Math.PI) };
  }
  return least;
}

/* How long a control signal is at its limit, s. */
function atLimit(data, state, result) {
  const made = controllerOf(data, state);
  if (!made) return 0;
  const limit = value(data, state, 'l');
  let most = 0;
  for (const output of made.outputs) {
    const u = column(result, output);
    let n = 0;
    for (let i = 0; i < u.length; ++i) if (Math.abs(u[i]) >= limit * (1 - 1e-9)) ++n;
    most = Math.max(most, n * result.h);
  }
  return most;
}

function verdictWords(data, state, verdict, least) {
  const seconds = (t) => digits(t, 1) + ' s';
  switch (verdict.kind) {
    case 'step': {
      const well = least && least.zeta > 0.02 ? `, though every eigenvalue is damped above ${digits(least.zeta - 5e-3, 2)}` : '';
      return ['Out of step', `at ${seconds(verdict.t)}${well}.`, 'bad'];
    }
    case 'collapse': return ['Collapse', `at ${seconds(verdict.t)}: the network equations have no solution.`, 'bad'];
    case 'grows': return ['Unstable.', controllerOf(data, state) ? 'The loop feeds the swing.' : 'The swing grows by itself.', 'bad'];
    case 'never': return ['On the edge.', 'The swing does not die out.', 'bad'];
    case 'slow': return ['Stable, but slow.', `The swing outlasts ${seconds(data.stop)}.`, 'good'];
    case 'settles':
      return verdict.t > 8 ? ['Stable, but slow.', `The swing takes ${seconds(verdict.t)} to die out.`, 'good']
        : ['Stable.', `The swing has died out after ${seconds(verdict.t)}.`, 'good'];
    default: return ['Still.', 'Nothing moves.', 'good'];
  }
}

/* What `judge` says of the run without the controller, once for each. */
function judgedAlone(data, state, base) {
  base.judged = base.judged || judge(data, { ...state, k: 'none' }, base);
  return base.judged;
}

/* How the grid does without the controller, where that is worth a word. */
function aloneWords(data, state, verdict, base) {
  if (!base || !controllerOf(data, state)) return '';
  const alone = judgedAlone(data, state, base), fails = (v) => v.kind === 'step' || v.kind === 'collapse';
  if (fails(verdict)) return fails(alone) ? 'without the controller it does so too' : 'without the controller the grid stays in step';
  if (fails(alone)) return 'without the controller the machines lose synchronism';
  return '';
}

/* What every channel adds on the way, and what it counted. */
function ledger(data, state, result) {
  return channelsOf(data, state).map((channel) => {
    const table = channelTable(data, state, channel), name = channel.name;
    const last = (what) => {
      const x = column(result, name + '_' + what);
      return x ? x[x.length - 1] : 0;
    };
    const ms = (x) => 1000 * (x || 0);
    const parts = { latency: ms(table.latency_s), waiting: ms(table.reporting_interval_s) / 2, jitter: ms(table.jitter_s) / 2 };
    return { name, signal: channel.signal, ...parts, total: parts.latency + parts.waiting + parts.jitter,
      packets: table.reporting_interval_s > 0, sent: last('sent'), delivered: last('delivered'),
      dropped: last('dropped'), late: last('late'), outages: table.outages_s || [] };
  });
}
