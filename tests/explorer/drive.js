/* Runs the scripts of a page in node, without a browser: `node drive.js page.html jobs.json` answers each job of the
 * list as one line of JSON. Jobs: {run: state, every, coarse, all, on: to the end}, {roots: state}, {toml: state}, {link: hash},
 * {address: state}, {judge: state}, {decay: speeds and controls}, {drag: n}. */
'use strict';
const fs = require('fs'), vm = require('vm'), zlib = require('zlib'), crypto = require('crypto');

const page = fs.readFileSync(process.argv[2], 'utf8');
const script = (pattern) => page.match(pattern)[1];
const scope = vm.createContext({ performance, WebAssembly, TextDecoder, TextEncoder, MessageChannel, URLSearchParams,
  document: { body: {} }, window: {} });
vm.runInContext(script(/<script id="shared">([^]*?)<\/script>/), scope);
vm.runInContext(script(/<script>([^]*?)<\/script>/), scope);
scope.text = script(/<script[^>]* id="blob">([^<]*)</).trim();
const bytes = zlib.gunzipSync(vm.runInContext('bytesOf(text)', scope));
const pieces = [];
let at = 4 + 4 * bytes.readUInt32LE(0);
for (let k = 0; k < bytes.readUInt32LE(0); ++k) {
  const length = bytes.readUInt32LE(4 + 4 * k);
  pieces.push(new Uint8Array(bytes.subarray(at, at + length)));
  at += length;
}
vm.runInContext(new TextDecoder().decode(pieces[1]), scope);
vm.runInContext('this.api = { Container, Eigenvalues, simulate, settingsOf, tomlOf, toLink, fromLink, keysOf, judge, decayOf, islandsOf, value };', scope);

(async () => {
  const { api } = scope, data = JSON.parse(new TextDecoder().decode(pieces[0]));
  const module = new WebAssembly.Module(pieces[2]), container = new api.Container(module, data, pieces.slice(3));
  const eigenvalues = new api.Eigenvalues(data), keys = api.keysOf(data), always = async () => true;
  const run = (state, job) => api.simulate(container, { settings: api.settingsOf(data, state), islands: api.islandsOf(data, state), every: job.every || 1,
    all: job.all !== false, coarse: Boolean(job.coarse && !job.on), solver: job.coarse ? data.solver : null }, always);
  for (const job of JSON.parse(fs.readFileSync(process.argv[3], 'utf8'))) {
    let answer;
    try {
      if (job.run) {
        const result = await run(job.run, job);
        const raw = Buffer.from(result.rows.buffer, result.rows.byteOffset, result.rows.byteLength);
        answer = { columns: result.columns, rows: result.rows.length / result.columns.length, why: result.why, ms: result.ms,
          hash: crypto.createHash('sha256').update(raw).digest('hex') };
        if (job.file) fs.writeFileSync(job.file, raw);
      } else if (job.roots) answer = eigenvalues.of(job.roots);
      else if (job.track) {
        const found = eigenvalues.of(job.track);
        answer = { ...await eigenvalues.track(job.track, always), found };
      } else if (job.toml) answer = api.tomlOf(data, job.toml, job.title || 'from the page');
      else if (job.link !== undefined) answer = api.fromLink(data, job.link, keys);
      else if (job.address) answer = api.toLink(data, job.address, keys);
      else if (job.judge) {
        const { kind, t, swing } = api.judge(data, job.judge, await run(job.judge, job));
        answer = { kind, t, swing: [...swing] };
      } else if (job.decay) {
        const floats = (rows) => rows.map((x) => Float64Array.from(x));
        answer = api.decayOf({ ...job.decay, speeds: job.decay.speeds.map(floats), controls: floats(job.decay.controls) });
      } else if (job.data) answer = data;
      else if (job.imports) answer = WebAssembly.Module.imports(module);
      else if (job.memory) answer = container.exports.memory.buffer.byteLength;
    } catch (error) {
      answer = { error: error.message };
    }
    console.log(JSON.stringify(answer === undefined ? null : answer));
  }
})();
