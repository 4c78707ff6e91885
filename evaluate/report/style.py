"""How a report looks: one column on a phone, two on a desk, by day and by night."""

from __future__ import annotations

from typing import Final

_COLOURS: Final = """
:root {
  color-scheme: light dark;
  --back: #f6f7f9; --card: #fff; --ink: #1b2430; --soft: #5b6675; --rule: #e1e5ea;
  --track: #0b6bcb; --gap: #e5393526; --lost: #d32f2f; --truth: #a9b2bd;
  --north: #0b6bcb; --east: #1f8f4d; --down: #d97706; --gps: #0b6bcb; --bds: #c2410c;
  --pll: #0f9d74; --fll: #e69f00; --fft: #d55e00; --pull: #56b4e9; --hold: #b86aa0;
  --other: #8a94a1;
  --a: #0b6bcb; --b: #d55e00; --c: #0f9d74; --d: #b0569a; --e: #8a6d00; --f: #475569;
}
@media (prefers-color-scheme: dark) { :root {
  --back: #0f141a; --card: #19212b; --ink: #e8edf3; --soft: #9aa7b6; --rule: #2b3643;
  --track: #5aa9ff; --gap: #ff5c5c33; --lost: #ff6b6b; --truth: #5d6a79;
  --north: #5aa9ff; --east: #4cc38a; --down: #f5a742; --gps: #5aa9ff; --bds: #ff9d66;
  --pll: #2cc295; --fll: #f2b632; --fft: #ff8142; --hold: #d58cc0;
  --a: #5aa9ff; --b: #ff8142; --c: #2cc295; --d: #d58cc0; --e: #d9b93b; --f: #a8b5c4;
} }
"""

_PAGE: Final = """
* { box-sizing: border-box; }
body { margin: 0; background: var(--back); color: var(--ink); overflow-wrap: anywhere;
  font: 1rem/1.5 system-ui, sans-serif; }
main { max-width: 76rem; margin: 0 auto; padding: 1.25rem 1rem 3rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0; }
h2 { font-size: 1.3rem; margin: 2.2rem 0 .8rem; }
h3 { font-size: 1.05rem; margin: 0 0 .6rem; }
h3.inner { margin: 1rem 0 .4rem; }
p { margin: .4rem 0; }
.soft, figcaption, .unit, .below { color: var(--soft); }
figure, details { margin: 0; padding: 1rem; min-width: 0; background: var(--card);
  border: 1px solid var(--rule); border-radius: .75rem; }
figcaption { margin-top: .6rem; }
summary { cursor: pointer; font-weight: 600; }
pre { margin: .8rem 0 0; white-space: pre-wrap; font-size: 1rem; }
.stack, .grid2 { display: grid; grid-template-columns: minmax(0, 1fr); gap: 1rem; }
@media (min-width: 60rem) {
  .grid2 { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .wide { grid-column: 1 / -1; }
}
@media print { body { background: #fff; } figure, details { break-inside: avoid; } }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(9.5rem, 1fr)); gap: .75rem;
  margin: 1.2rem 0 0; padding: 0; list-style: none; }
.tiles li { padding: .7rem .9rem; background: var(--card); border: 1px solid var(--rule);
  border-radius: .75rem; }
.tiles b { display: block; font-size: 1.45rem; line-height: 1.25; }
.tiles span { display: block; line-height: 1.3; color: var(--soft); }
"""

_CHARTS: Final = """
.area, .square { position: relative; }
.square { width: 100%; }
.chart .area { margin: .8rem 1rem 1.9rem 3.4rem; }
.chart .below { text-align: center; margin-top: -.2rem; }
.area svg, .square svg { position: absolute; inset: 0; width: 100%; height: 100%; }
.area svg { overflow: hidden; }
.square svg { overflow: visible; }
.map svg { overflow: hidden; }
path, circle, rect { vector-effect: non-scaling-stroke; }
path { stroke-linecap: round; stroke-linejoin: round; }
path:not([fill]) { fill: none; }
.grid { stroke: var(--rule); stroke-width: 1; }
.area span, .square span { position: absolute; white-space: nowrap; line-height: 1; }
.x { top: 100%; transform: translate(-50%, .45rem); color: var(--soft); }
.y { right: 100%; transform: translate(-.45rem, -50%); color: var(--soft); }
.mark, .ring { transform: translate(-50%, -50%); }
.mark { text-shadow: 0 0 3px var(--card), 0 0 3px var(--card), 0 0 3px var(--card); }
.ring { color: var(--soft); background: var(--card); padding: 0 .15rem; }
.scale { display: flex; gap: .5rem; align-items: end; line-height: 1; }
.scale div { height: .55rem; border: solid var(--ink); border-width: 0 2px 2px; }
.square .north { right: 0; top: 0; text-align: center; line-height: 1.1; font-weight: 600; }
.legend { display: flex; flex-wrap: wrap; gap: .2rem 1rem; margin: .7rem 0 0; padding: 0;
  list-style: none; }
.legend i { display: inline-block; width: .85em; height: .85em; margin-right: .4em;
  border-radius: .2em; vertical-align: -.06em; }
.strip { display: grid; grid-template-columns: 2.6rem minmax(0, 1fr) 2rem; gap: .6rem;
  align-items: end; line-height: 1.2; }
.strip .area { height: 2.3rem; border-bottom: 1px solid var(--rule); }
.strip em { text-align: right; color: var(--soft); }
.strip.last > * { margin-bottom: 1.8rem; }
.bars { display: grid; gap: .35rem; }
.bar { display: grid; grid-template-columns: minmax(0, 8rem) minmax(0, 1fr) 4.2rem; gap: .6rem;
  align-items: center; line-height: 1.2; }
.bar div { height: .9rem; background: var(--rule); border-radius: .3rem; }
.bar i { display: block; height: 100%; border-radius: .3rem; }
.bar em { text-align: right; }
em { font-style: normal; }
.tiles b, .strip em, .bar em, .n, .x, .y { font-variant-numeric: tabular-nums; }
"""

_TABLES: Final = """
table { width: 100%; border-collapse: collapse; }
th, td { padding: .4rem .6rem; text-align: left; vertical-align: top;
  border-bottom: 1px solid var(--rule); }
th { color: var(--soft); font-weight: 600; }
tr:last-child td { border-bottom: 0; }
.n { text-align: right; }
td.n { white-space: nowrap; }
@media (max-width: 48rem) {
  thead { position: absolute; left: -999rem; }
  table, tbody, tr, td { display: block; }
  tr { padding: .6rem 0; border-bottom: 1px solid var(--rule); }
  tr:last-child { border: 0; }
  td, td.n { display: inline-block; padding: 0 1rem 0 0; border: 0; text-align: left;
    white-space: normal; }
  td:first-child { display: block; padding: 0; font-weight: 600; }
  td:not(:first-child)::before { content: attr(data-label) " "; color: var(--soft); }
  td:empty { display: none; }
}
"""

STYLE: Final = "".join((_COLOURS, _PAGE, _CHARTS, _TABLES))
"""CSS of a page; it names no file and no address."""
