"use strict";

// Tables, curves and pictures of runs that train, evaluate or compare.

const kSeriesColours = ["#1763b6", "#c2570c", "#2a8a57", "#8b4fb3", "#b3293c", "#6b6f76", "#0f8a94", "#9a7a00"];
const kChart = {width: 540, height: 320, left: 64, right: 14, top: 12, bottom: 42};

function svg(tag, attributes, ...children) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

function isNumber(text) {
  return /^[<×\s]*[-+]?[0-9.]/.test(text);
}

function resultTable(part) {
  // A column of numbers is set to the right.
  const numeric = part.columns.map((_, column) => column > 0 && part.rows.every((row) => row[column] === "" || isNumber(row[column])));
  const cell = (tag, text, column) => element(tag, {className: numeric[column] ? "number" : ""}, text);
  return element("div", {className: "wide"}, element("table", {},
    element("thead", {}, element("tr", {}, ...part.columns.map((text, column) => cell("th", text, column)))),
    element("tbody", {}, ...part.rows.map((row) => element("tr", {}, ...row.map((text, column) => cell("td", text, column)))))));
}

// Round values between two ends, of a logarithmic axis powers of ten.
function ticksOf(low, high, logarithmic) {
  const ticks = [];
  if (logarithmic) {
    const steps = high / low > 50 ? [1] : [1, 2, 5];
    for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); ++power) {
      for (const step of steps) ticks.push(step * 10 ** power);
    }
  } else {
    const rough = (high - low) / 5;
    const unit = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * unit).find((size) => size >= rough);
    for (let i = Math.ceil(low / step); i * step <= high; ++i) ticks.push(i * step);
  }
  return ticks.filter((tick) => tick >= low && tick <= high);
}

function rangeOf(values, logarithmic) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    low = Math.min(low, value);
    high = Math.max(high, value);
  }
  // Between values that differ by rounding alone no tick could be told from the next.
  if (high - low > 1e-12 * Math.max(Math.abs(low), Math.abs(high))) return [low, high];
  return logarithmic ? [low / 2, high * 2] : [low - 1, high + 1];
}

function chartPicture(chart) {
  const {width, height, left, right, top, bottom} = kChart;
  const points = chart.series.flatMap((series) => series.points);
  const [x0, x1] = rangeOf(points.map((point) => point[0]), false);
  const [y0, y1] = rangeOf(points.map((point) => point[1]).filter((value) => value !== null), chart.logarithmic);
  const scale = chart.logarithmic ? Math.log : (value) => value;
  const xOf = (x) => left + (x - x0) / (x1 - x0) * (width - left - right);
  const yOf = (y) => height - bottom - (scale(y) - scale(y0)) / (scale(y1) - scale(y0)) * (height - top - bottom);
  const picture = svg("svg", {viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": chart.title});
  for (const tick of ticksOf(y0, y1, chart.logarithmic)) {
    picture.append(svg("line", {class: "grid", x1: left, x2: width - right, y1: yOf(tick), y2: yOf(tick)}),
      svg("text", {x: left - 8, y: yOf(tick) + 4, "text-anchor": "end"}, String(Number(tick.toPrecision(6)))));
  }
  for (const tick of ticksOf(x0, x1, false)) {
    picture.append(svg("text", {x: xOf(tick), y: height - bottom + 18, "text-anchor": "middle"}, String(Number(tick.toPrecision(6)))));
  }
  picture.append(svg("line", {class: "axis", x1: left, x2: width - right, y1: height - bottom, y2: height - bottom}),
    svg("text", {x: (left + width - right) / 2, y: height - 6, "text-anchor": "middle"}, chart.x));
  chart.series.forEach((series, i) => {
    let path = "", pen = "M";
    for (const [x, y] of series.points) {
      if (y === null) {
        pen = "M";
        continue;
      }
      path += `${pen}${xOf(x).toFixed(1)} ${yOf(y).toFixed(1)}`;
      pen = "L";
    }
    picture.append(svg("path", {d: path, fill: "none", stroke: kSeriesColours[i % kSeriesColours.length], "stroke-width": 1.8, "stroke-linejoin": "round"}));
  });
  return picture;
}

function resultCharts(part) {
  return element("div", {className: "charts"}, ...part.charts.map((chart) => {
    const legend = element("figcaption", {});
    chart.series.forEach((series, i) => {
      const swatch = element("span", {className: "swatch"});
      swatch.style.background = kSeriesColours[i % kSeriesColours.length];
      legend.append(element("span", {className: "key"}, swatch, series.name));
    });
    return element("figure", {}, element("h3", {}, chart.title), chartPicture(chart), legend);
  }));
}

function resultPictures(part) {
  return element("div", {className: "sheets"}, ...part.pictures.map((picture) =>
    element("figure", {}, element("img", {src: picture.address, alt: picture.name, loading: "lazy"}), element("figcaption", {}, picture.name))));
}

function showResults(main) {
  const makers = {table: resultTable, charts: resultCharts, pictures: resultPictures};
  for (const part of page.parts) main.append(section(part.title, part.hint, makers[part.type](part)));
}
