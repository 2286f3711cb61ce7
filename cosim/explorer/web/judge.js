/* What a run came to, from its record. */
'use strict';

/* The swing that the page draws, mHz. */
function swingOf(data, result) {
  const sum = new Float64Array(result.rows.length / result.columns.length);
  for (const [machine, weight] of Object.entries(data.swing.weights)) {
    const x = column(result, machine + '_dw');
    for (let i = 0; i < sum.length; ++i) sum[i] += 1000 * data.case.frequency * weight * x[i];
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

/* Machines and voltage sources of each island, less what an event trips. */
function islandsOf(data, state) {
  const gone = eventTables(data, state).map((e) => (/(machine|frequency|device)_trip/.test(e.kind) ? e.machine || e.device : ''));
  return data.islands.map((names) => names.filter((name) => !gone.includes(name)));
}

/* When two of an island are half a turn apart; NaN where none are. */
function outOfStep(islands, result) {
  const angles = islands.map((names) => names.map((name) => column(result, name + '_delta')));
  for (let i = 0; i < result.rows.length / result.columns.length; ++i) for (const group of angles) {
    const now = group.map((x) => x[i]);
    if (Math.max(...now) - Math.min(...now) >= Math.PI) return i * result.h;
  }
  return NaN;
}

/* The rule of cosim/results/verdict.py with its limits, of points h apart; tests/explorer/test_page_verdict.py runs both. */
const LAST = 5;

/* The window that is judged: between two marks. */
function windowOf(events, marks, stop) {
  const last = Math.max(0, ...events.filter((t) => t < stop));
  const edges = [...new Set([last, stop, ...marks.filter((t) => t > last && t < stop)])].sort((a, b) => a - b);
  const pairs = edges.slice(1).map((t, k) => [edges[k], t]), long = pairs.filter(([a, b]) => b - a >= LAST);
  return long.pop() || pairs.reduce((a, b) => (b[1] - b[0] > a[1] - a[0] ? b : a));
}

/* Place in VERDICTS of a signal with these spans, and by how much it fails to fall. */
function placeOf([largest, before, last]) {
  const ratio = before > 0 ? last / before : 2 * (last > 0);
  if (largest < NOTHING || last < NOTHING || last <= 0.02 * largest) return [0, 0];
  if (ratio <= 0.995) return [last <= 0.2 * largest ? 0 : 1, ratio];
  return [ratio >= 1.02 ? 3 : 2, ratio];
}

/* What comes last by place, then by ratio, then by the last span. */
function worstOf(rows) {
  const key = (row) => [...placeOf(row), row[2]];
  return rows.reduce((a, b) => {
    const x = key(a), y = key(b), k = x.findIndex((value, i) => value !== y[i]);
    return k >= 0 && y[k] > x[k] ? b : a;
  });
}

/* Span of a signal less its straight line, of samples from a to b, both in points. */
function bendOf(x, a, b, spacing) {
  const at = (t, i) => x[i] + (t - i) * ((i + 1 < x.length ? x[i + 1] : x[i]) - x[i]);
  const part = Array.from({ length: Math.floor((b - a) / spacing + 1e-9) + 1 }, (_, k) => at(a + k * spacing, Math.floor(a + k * spacing + 1e-9)));
  const n = part.length, mean = part.reduce((sum, y) => sum + y, 0) / n;
  const slope = part.reduce((sum, y, i) => sum + (i - (n - 1) / 2) * (y - mean), 0) * 12 / (n * (n * n - 1));
  return n < 3 ? 0 : span(part.map((y, i) => y - slope * i), 0, n);
}

/* {kind, spans, window} of speeds by island and controls within `limit`; events and marks (outages too), s. */
function decayOf({ speeds, controls, limit, h, stop, events, marks }) {
  const window = windowOf(events, marks, stop), [begin, end] = window;
  if (!(end - begin >= Math.min(2, stop))) return { kind: 'not judged', spans: [0, 0, 0], window };
  const width = Math.min(Math.max(LAST, 0.25 * (end - begin)), 0.5 * (end - begin)), since = Math.max(0, ...events.filter((t) => t < end));
  const first = since > 0 ? Math.floor(since / h + 1e-9) + 1 : 0;
  const final = end < stop || marks.some((t) => t >= end) ? Math.ceil(end / h - 1e-9) : Math.floor(end / h + 1e-9) + 1;
  const windows = [[since, end], [end - 2 * width, end - width], [end - width, end]]
    .map(([a, b]) => [Math.max(first, Math.ceil(a / h - 1e-9)), Math.min(final, Math.floor(b / h + 1e-9) + 1)]);
  const bend = (x, back) => bendOf(x, (end - (back + 1) * width) / h, (end - back * width) / h, Math.max(0.05, width / 512) / h);
  const spans = (x) => windows.map((w) => span(x, ...w));
  const family = (signals) => {
    const rows = signals.map(spans), scale = Math.max(...rows.map((row) => row[0]));
    return worstOf(rows.map((row) => [scale, row[1], row[2]]));
  };
  const means = speeds.map((group) => group[0].map((_, i) => group.reduce((sum, x) => sum + x[i], 0) / group.length));
  const rows = [family(speeds.flatMap((group, k) => group.map((x) => (group.length > 1 ? x.map((y, i) => y - means[k][i]) : x))))];
  const common = speeds.flatMap((group, k) => (group.length > 1
    ? [[Math.max(rows[0][0], span(means[k], ...windows[0])), bend(means[k], 1), bend(means[k], 0)]] : []));
  if (common.length) {
    const most = common.reduce((a, b) => (b[2] > a[2] ? b : a));
    if (most[2] > 0.2 * most[0]) rows.push(most);
  }
  if (controls.length) rows.push(family(controls));
  const atLimit = controls.some((u) => u.slice(...windows[2]).some((y) => Math.abs(y) >= (1 - 1e-3) * limit));
  const worst = worstOf(rows);
  return { kind: VERDICTS[atLimit ? 2 : placeOf(worst)[0]], spans: worst, window, atLimit };
}

/* Instants at which the output of a channel may jump, packets aside, s. */
function marksOf({ outages_s: outages = [], on_loss: rule, hold_s: hold, signal_faults: faults = [], reporting_interval_s: packets, latency_s: late = 0 }) {
  const ends = outages.flatMap(([from, to]) => (rule === 'hold_then_zero' && from + hold < to ? [from, to, from + hold] : [from, to]));
  return packets ? ends : [...ends, ...faults.flatMap((f) => [f.start_s, f.end_s]).filter(Number.isFinite).map((t) => t + late)];
}

/* {kind, t, swing, ..}: kind is one of VERDICTS, 'not judged' or 'collapse'; t: of the loss, else of settling, null: later;
 * limited: how long a control is at its limit, s. */
function judge(data, state, result) {
  const swing = swingOf(data, result), { h } = result, islands = islandsOf(data, state), lost = outOfStep(islands, result);
  const controller = controllerOf(data, state), controls = controller ? controller.outputs.map((name) => column(result, name)) : [], limit = value(data, state, 'l');
  const limited = Math.max(0, ...controls.map((u) => h * u.filter((y) => Math.abs(y) >= limit * (1 - 1e-9)).length));
  if (Number.isFinite(lost)) return { kind: VERDICTS[4], t: lost, swing, limited };
  if (result.why) return { kind: 'collapse', t: (swing.length - 1) * h, swing, limited };
  const speeds = islands.map((names) => names.map((name) => column(result, name + '_dw')).filter(Boolean)).filter((group) => group.length);
  const events = eventTables(data, state).filter((e) => !/^frequency/.test(e.kind))
    .flatMap((e) => [e.start_s, e.start_s + (e.rise_s || 0), e.end_s]).filter(Number.isFinite);
  const marks = channelsOf(data, state).flatMap((c) => marksOf(channelTable(data, state, c)));
  const decay = decayOf({ speeds, controls, limit, h, stop: data.stop, events, marks: [...events, ...marks] });
  const end = Math.max(0, ...events.filter((t) => t < data.stop)), small = 0.02 * Math.max(...swing.map(Math.abs));
  let last = swing.length - 1;
  while (last * h > end && Math.abs(swing[last]) <= small) --last;
  return { ...decay, t: last < swing.length - 1 ? Math.max(last * h - end, 0) : null, swing, limited };
}

/* Least damped swing mode of the roots in sight. */
function leastDamped(roots) {
  let least = null;
  for (const { s } of roots || []) {
    const zeta = -s[0] / Math.hypot(s[0], s[1]);
    if (s[1] > 0.6 && (least === null || zeta < least.zeta)) least = { zeta, hertz: s[1] / (2 * Math.PI), rate: s[0] };
  }
  return least;
}
