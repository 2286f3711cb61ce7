/* Values under the pointer of every figure that brings its curves: JSON in a script beside the drawing. */
for (const data of document.querySelectorAll('figure script[type="application/json"]')) {
  const figure = data.closest('figure'), svg = figure.querySelector('svg');
  const { size, axes, bars = [] } = JSON.parse(data.textContent);
  const box = document.createElement('div');
  box.className = 'values';
  box.hidden = true;
  figure.append(box);
  const nearest = (xs, x) => {
    let low = 0, high = xs.length - 1;
    while (high - low > 1) {
      const mid = (low + high) >> 1;
      if (xs[mid] <= x) low = mid; else high = mid;
    }
    return x - xs[low] < xs[high] - x ? low : high;
  };
  const number = (x) => (Number.isFinite(x) ? String(Number(x.toPrecision(4))).replace('-', '\u2212') : '\u2013');
  const valuesOf = (axis, share) => {
    const [low, high] = axis.x;
    const value = axis.log ? low * (high / low) ** share : low + share * (high - low);
    const lines = axis.curves.map((curve) => curve.name + ' ' + number(curve.y[nearest(curve.x, value)]));
    return [axis.name + ' ' + number(value), ...lines].join('\n');
  };
  svg.addEventListener('pointermove', (event) => {
    const frame = svg.getBoundingClientRect(), origin = figure.getBoundingClientRect();
    const x = (event.clientX - frame.left) / frame.width * size[0];
    const y = (event.clientY - frame.top) / frame.height * size[1];
    const over = ({ at }) => x >= at[0] && x <= at[2] && y >= at[1] && y <= at[3];
    const bar = bars.find(over), axis = axes.find(over);
    box.hidden = !bar && !axis;
    if (box.hidden) return;
    box.textContent = bar ? bar.text : valuesOf(axis, (x - axis.at[0]) / (axis.at[2] - axis.at[0]));
    const left = Math.min(event.clientX - origin.left + 14, origin.width - box.offsetWidth - 4);
    box.style.transform = `translate(${Math.max(left, 4)}px, ${event.clientY - origin.top + 14}px)`;
  });
  svg.addEventListener('pointerleave', () => { box.hidden = true; });
}
