"""The look of the report: its style sheet."""

from importlib.resources import files

STYLE = """
:root { --ink: #1b2430; --quiet: #64707d; --paper: #f6f7f9; --card: #ffffff; --rule: #dfe4e9; --accent: #1f5bd0;
  --warm: #8a5a00; --warm-paper: #fff7e3; --warm-rule: #f0d890; --good: #17743f; --good-paper: #e3f5ea;
  --bad: #a11a1a; --bad-paper: #fde8e6; --blue: #0072b2; --sky: #3f8fc4; --red: #c94a00; --gold: #8a6d00;
  --pink: #a8487f; }
@media (prefers-color-scheme: dark) { :root { --ink: #e3e8ee; --quiet: #97a3b0; --paper: #12161b; --card: #1a2027;
  --rule: #2b333c; --accent: #7aa5ff; --warm: #f2c862; --warm-paper: #2a2413; --warm-rule: #5a4a1c; --good: #7fd8a2;
  --good-paper: #15301f; --bad: #ff9c91; --bad-paper: #3a1a18; --blue: #56b4e9; --sky: #7d9db5; --red: #ff8a3d;
  --gold: #f0e442; --pink: #e79ac6; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 2.6rem 1.25rem 1rem; overflow-wrap: anywhere; }
h1 { font-size: clamp(1.6rem, 4vw, 2.3rem); line-height: 1.2; margin: 0 0 1.3rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.6rem 0 0.9rem; }
h3 { font-size: 0.95rem; margin: 0 0 0.5rem; }
h3::first-letter, summary::first-letter, tr > th::first-letter { text-transform: uppercase; }
.kicker { margin: 0 0 0.2rem; color: var(--quiet); font-size: 0.85rem; letter-spacing: 0.06em;
  text-transform: uppercase; }
.quiet, figcaption, footer { color: var(--quiet); font-size: 0.9rem; }
.badge { display: inline-block; margin-left: 0.8rem; padding: 0.15em 0.7em; border-radius: 1em; font-size: 0.85rem;
  font-weight: 600; vertical-align: middle; }
.badge.good { color: var(--good); background: var(--good-paper); }
.badge.note { color: var(--warm); background: var(--warm-paper); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); gap: 0.7rem; }
.tile, .card, figure, .plot { background: var(--card); border: 1px solid var(--rule); border-radius: 10px; }
.tile { padding: 0.8rem 1rem; display: flex; flex-direction: column; }
.tile b { font-size: 1.55rem; line-height: 1.25; font-variant-numeric: tabular-nums; }
.tile span { color: var(--quiet); font-size: 0.85rem; }
.warnings { margin-top: 1.4rem; padding: 0.9rem 1.2rem; border: 1px solid var(--warm-rule); border-radius: 10px;
  background: var(--warm-paper); color: var(--warm); }
.warnings h2 { margin: 0; font-size: 1rem; }
.warnings ul { margin: 0.35rem 0 0; padding-left: 1.2rem; overflow-wrap: anywhere; }
.plot { height: clamp(300px, 62vw, 620px); overflow: hidden; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(320px, 100%), 1fr)); gap: 0.9rem;
  align-items: start; }
.card { padding: 0.9rem 1.1rem; min-width: 0; }
.card.wide { grid-column: 1 / -1; }
summary { cursor: pointer; font-weight: 600; }
summary small { color: var(--quiet); font-weight: 400; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
th, td { padding: 0.32rem 0.9rem 0.32rem 0; border-top: 1px solid var(--rule); text-align: left; vertical-align: top; }
tbody th { font-weight: 400; color: var(--quiet); overflow-wrap: normal; }
tbody th + td { text-align: right; padding-right: 0; overflow-wrap: anywhere; }
thead th { border-top: 0; color: var(--quiet); font-weight: 600; white-space: nowrap; }
:not(thead) + tbody tr:first-child > *, table > tbody:first-child tr:first-child > * { border-top: 0; }
figure { margin: 0 0 1.2rem; padding: 0; overflow: hidden; }
figure img { display: block; width: 100%; height: auto; background: #ffffff; }
figcaption { padding: 0.8rem 1.1rem 0.95rem; border-top: 1px solid var(--rule); }
figcaption b { color: var(--ink); }
footer { max-width: 1120px; margin: 2rem auto 0; padding: 1.1rem 1.25rem 2.4rem; border-top: 1px solid var(--rule); }
footer p { margin: 0.1rem 0; }
.skip { position: absolute; left: -999px; }
.skip:focus { left: 1rem; top: 0.6rem; padding: 0.3rem 0.8rem; background: var(--card); color: var(--ink); z-index: 9; }
main:focus { outline: none; }
a { color: var(--accent); }
nav ul { display: flex; flex-wrap: wrap; gap: 0.2rem 1.1rem; margin: 1.2rem 0 0; padding: 0; list-style: none;
  font-size: 0.9rem; }
.wide table, section > .card table, .tile { overflow-wrap: normal; }
.badge.bad { color: var(--bad); background: var(--bad-paper); }
.badge.none { color: var(--quiet); border: 1px solid var(--rule); }
.why { margin: 1rem 0 0; }
.warnings li { margin-top: 0.5rem; }
.warnings li p { margin: 0.1rem 0; }
.findings { list-style: none; margin: 0; }
.findings li + li { margin-top: 0.9rem; }
.findings p { margin: 0.1rem 0; }
.findings .badge { margin-left: 0.3rem; }
.cells { display: block; width: 100%; height: 84px; background: var(--card); border: 1px solid var(--rule); }
.cells g:hover { opacity: 0.6; }
.cells .begin { stroke: var(--ink); stroke-width: 2; fill: none; vector-effect: non-scaling-stroke; }
.tracked { fill: var(--sky); } .keyframe { fill: var(--blue); } .weak { fill: var(--gold); }
.loop { fill: var(--pink); } .lost { fill: var(--red); } .skipped { fill: var(--quiet); }
svg .mark { stroke: var(--card); stroke-width: 1.5; fill: none; vector-effect: non-scaling-stroke; }
svg .open { fill: none; stroke: var(--quiet); stroke-width: 1.5; vector-effect: non-scaling-stroke; }
.ends { display: flex; justify-content: space-between; margin: 0.2rem 0 0; color: var(--quiet); font-size: 0.85rem; }
.signs { display: flex; flex-wrap: wrap; gap: 0.35rem 1.4rem; margin: 0.8rem 0 0; padding: 0; list-style: none;
  font-size: 0.9rem; }
.signs li { display: flex; align-items: center; gap: 0.5rem; }
.signs svg { flex: none; width: 12px; height: 26px; border-bottom: 1px solid var(--quiet); }
.where { margin: 0.6rem 0 0; padding-left: 1.2rem; }
.chart { margin: 0.9rem 0 0; padding: 0.7rem 1rem; }
.chart figcaption { border: 0; padding: 0 0 0.3rem; color: var(--ink); }
.chart .frame { position: relative; }
.chart .top { position: absolute; left: 0.2rem; top: 0; padding: 0 0.2rem; color: var(--quiet); font-size: 0.85rem;
  background: var(--card); }
.chart svg { display: block; width: 100%; height: 150px; border-left: 1px solid var(--rule);
  border-bottom: 1px solid var(--rule); }
.chart .curve { fill: none; stroke: var(--blue); stroke-width: 1.6; vector-effect: non-scaling-stroke; }
.chart .level { fill: none; stroke: var(--ink); stroke-width: 1; stroke-dasharray: 5 4;
  vector-effect: non-scaling-stroke; }
.timings { max-width: 760px; }
.stage { padding: 0.8rem; background: var(--card); border: 1px solid var(--rule); border-radius: 10px; }
.screen { position: relative; max-width: 820px; background: #000000; }
.pictures .tiles { margin-bottom: 1.2rem; }
.screen img, .screen canvas { display: block; width: 100%; height: auto; }
.screen canvas { position: absolute; inset: 0; height: 100%; }
.row { display: flex; flex-wrap: wrap; align-items: center; gap: 0.5rem 1rem; margin: 0.7rem 0 0; font-size: 0.9rem; }
.row button { font: inherit; padding: 0.35em 0.95em; border: 1px solid var(--rule); border-radius: 2em; cursor: pointer;
  background: var(--card); color: var(--ink); }
.row button:hover { border-color: var(--accent); }
.row button[aria-disabled="true"] { color: var(--quiet); cursor: default; }
.gallery .legend { display: inline-flex; align-items: center; gap: 0.4rem; color: var(--quiet); }
.gallery .legend .bar { display: inline-block; width: 90px; height: 0.7em; border-radius: 2px; }
.gallery .said { margin: 0.6rem 0 0; font-variant-numeric: tabular-nums; }
.previews { list-style: none; margin: 0; padding: 0; }
.previews button { display: block; padding: 0; border: 3px solid transparent; background: none; cursor: pointer; }
.previews img { display: block; width: calc(64px * var(--ratio)); height: 64px; }
.previews li { display: inline-block; margin: 0 2px 2px 0; vertical-align: top; }
.gallery:not(.live) .previews li:first-child img { width: min(480px, 100%); height: auto; }
.live .previews { display: flex; overflow-x: auto; margin-top: 0.7rem; padding-bottom: 0.4rem; position: relative; }
.live .previews li { flex: none; }
.previews .lost { border-bottom-color: var(--red); border-bottom-style: dashed; }
.previews [aria-current] { border-color: var(--accent); border-style: solid; }
:is(.row button, .row input, .previews button, .scroll, summary, a, .reset):focus-visible {
  outline: 2px solid var(--accent); outline-offset: 2px; }
.on-paper, .live.single :is(.previous, .next, .previews) { display: none; }
@media (max-width: 480px) { main { padding: 1.4rem 0.9rem 1rem; } .tile b { font-size: 1.25rem; }
  .tiles { grid-template-columns: repeat(auto-fit, minmax(135px, 1fr)); } h1 .badge { margin-left: 0.4rem; } }
@media print { body { background: none; }
  .skip, nav, .stage, .row, .previews li:not(:first-child) { display: none; }
  .live .previews, .live.single .previews { display: block; }
  .previews img { width: 480px; height: auto; max-width: 100%; }
  .previews button { border: 0; } .on-paper { display: block; }
  .tile, .badge, .cells, rect, path { print-color-adjust: exact; }
  h2, h3 { break-after: avoid; } .strip, .chart, .timings { break-inside: avoid; } }
@media print { figure, .card { break-inside: avoid; } }
"""
STYLE += files("tspslam.view").joinpath("_web", "scene.css").read_text(encoding="utf-8")
