"""The look of the report: its style sheet."""

from importlib.resources import files

STYLE = """
:root { --ink: #1b2430; --quiet: #64707d; --paper: #f6f7f9; --card: #ffffff; --rule: #dfe4e9; --accent: #2f6fed;
  --warm: #8a5a00; --warm-paper: #fff7e3; --warm-rule: #f0d890; --good: #17743f; --good-paper: #e3f5ea; }
@media (prefers-color-scheme: dark) { :root { --ink: #e3e8ee; --quiet: #97a3b0; --paper: #12161b; --card: #1a2027;
  --rule: #2b333c; --accent: #7aa5ff; --warm: #f2c862; --warm-paper: #2a2413; --warm-rule: #5a4a1c; --good: #7fd8a2;
  --good-paper: #15301f; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", "DejaVu Sans", sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 2.6rem 1.25rem 1rem; }
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
tbody th { font-weight: 400; color: var(--quiet); }
tbody th + td { text-align: right; padding-right: 0; overflow-wrap: anywhere; }
thead th { border-top: 0; color: var(--quiet); font-weight: 600; white-space: nowrap; }
:not(thead) + tbody tr:first-child > *, table > tbody:first-child tr:first-child > * { border-top: 0; }
figure { margin: 0 0 1.2rem; padding: 0; overflow: hidden; }
figure img { display: block; width: 100%; height: auto; background: #ffffff; }
figcaption { padding: 0.8rem 1.1rem 0.95rem; border-top: 1px solid var(--rule); }
figcaption b { color: var(--ink); }
footer { max-width: 1120px; margin: 2rem auto 0; padding: 1.1rem 1.25rem 2.4rem; border-top: 1px solid var(--rule); }
footer p { margin: 0.1rem 0; }
@media print { figure, .card { break-inside: avoid; } }
"""
STYLE += files("tspslam.view").joinpath("_web", "scene.css").read_text(encoding="utf-8")
