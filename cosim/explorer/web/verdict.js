/* What a run did, in numbers and words. */
'use strict';

const minus = (text) => String(text).replace('-', '−');
const VERDICTS = ['settled', 'settling slowly', 'standing swing', 'growing', 'synchronism lost'], NOTHING = 1e-9;   /* pu */
const digits = (x, n) => minus(x.toFixed(n));

/* One column of a result: a view of every `width`-th number. */
function column(result, name) {
  const k = result.columns.indexOf(name), width = result.columns.length, n = result.rows.length / width;
  if (k < 0) return null;
  const out = new Float64Array(n);
  for (let i = 0; i < n; ++i) out[i] = result.rows[i * width + k];
  return out;
}

function verdictWords(data, state, { kind, t, spans, window, atLimit }, least) {
  const at = `at ${digits(t || 0, 1)} s`, place = VERDICTS.indexOf(kind);
  if (kind === 'collapse') return ['Collapse', at + ': the network equations have no solution.', 'bad'];
  if (place === 4) {
    const well = least && least.zeta > 0.02 ? `, though every eigenvalue is damped above ${digits(least.zeta - 5e-3, 2)}` : '';
    return ['Synchronism lost', at + well + '.', 'bad'];
  }
  if (place < 0) return ['Not judged.', 'The run ends too soon after the last event.', 'bad'];
  if (place === 3) return ['Growing.', controllerOf(data, state) ? 'The loop feeds the swing.' : 'The swing grows by itself.', 'bad'];
  if (place === 2) return ['Standing swing.', atLimit ? 'The control still reaches its limit.' : 'It does not die out.', 'bad'];
  const still = spans[0] < NOTHING;
  if (least && least.rate > 0 && window[1] >= data.stop && (still || least.rate * (window[1] - window[0]) < 2))
    return ['Growing.', 'An eigenvalue grows, too slowly for this run to show it.', 'bad'];
  if (still) return ['Settled.', 'Nothing moves.', 'good'];
  return [place ? 'Settling slowly.' : 'Settled.', t === null ? `Over 2 % are left after ${data.stop} s.` : `Below 2 % of its peak after ${digits(t, 1)} s.`, 'good'];
}

/* How the grid does without the controller, where that is worth a word. */
function aloneWords(data, state, verdict, base) {
  if (!base || !controllerOf(data, state)) return '';
  const [withControl, without] = [verdict, base.judged].map(({ kind }) => kind === VERDICTS[4] || kind === 'collapse');
  const words = without ? (withControl ? 'it does so too' : 'the machines lose synchronism') : withControl ? 'the grid stays in step' : '';
  return words && 'without the controller ' + words;
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
