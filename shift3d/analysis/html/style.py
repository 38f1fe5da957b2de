"""How the page looks, in light and dark, wide and narrow."""

__all__ = ["STYLE"]

STYLE = """
:root { color-scheme: light dark; --text: #1b1d21; --muted: #575d66; --ground: #ffffff; --panel: #f4f5f7;
  --line: #d5d8dd; --link: #0b5ea8; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e6e8eb; --muted: #a4abb5; --ground: #15171b; --panel: #1e2127; --line: #3a3f47; --link: #7cbcf5; }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
@media (prefers-reduced-motion: reduce) { html { scroll-behavior: auto; } }
body { font: 16px/1.55 system-ui, sans-serif; color: var(--text); background: var(--ground); max-width: 80rem;
  margin: 0 auto; padding: 1rem clamp(.75rem, 3vw, 2rem) 4rem; overflow-wrap: anywhere; }
h1 { font-size: clamp(1.5rem, 4vw, 2.1rem); line-height: 1.2; margin: 1rem 0 .5rem; }
h2 { font-size: 1.4rem; margin: 3rem 0 .5rem; padding-top: .75rem; border-top: 1px solid var(--line); }
h3 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
h4 { font-size: 1rem; margin: 1.25rem 0 .25rem; }
p, ul, dl { max-width: 48rem; }
a { color: var(--link); }
:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; }
.skip { position: absolute; left: -999rem; }
.skip:focus { left: 1rem; top: .5rem; background: var(--ground); padding: .5rem 1rem; z-index: 9; }
nav ul { list-style: none; padding: 0; margin: 1rem 0; display: flex; flex-wrap: wrap; gap: .35rem 1.1rem;
  max-width: none; }
.missing { color: var(--muted); font-style: italic; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .875rem; font-variant-numeric: tabular-nums; overflow-wrap: normal; }
caption { text-align: left; color: var(--muted); padding: 0 0 .4rem; }
caption span { display: inline-block; position: sticky; left: 0; max-width: min(48rem, calc(100vw - 5rem)); }
th, td { padding: .3rem .65rem; text-align: right; vertical-align: top; border-bottom: 1px solid var(--line);
  white-space: nowrap; font-weight: normal; }
thead th { font-weight: 600; vertical-align: bottom; }
th[scope=row], thead th:first-child { text-align: left; position: sticky; left: 0; background: var(--ground); }
td small { display: block; color: var(--muted); font-size: .75rem; }
tr.ours td, tr.ours th { font-weight: 600; }
tr.paper td, tr.paper th { color: var(--muted); font-style: italic; }
table.words td { text-align: left; white-space: normal; }
dl > div { display: grid; grid-template-columns: 9.5rem 1fr; gap: .2rem 1rem; padding: .2rem 0; }
dt { font-weight: 600; } dd { margin: 0; }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 21rem), 1fr)); gap: 1rem; }
figure { margin: 1rem 0; min-width: 0; }
.panels.wide { grid-template-columns: repeat(auto-fit, minmax(min(100%, 30rem), 1fr)); }
.panels figure { margin: 0; }
figcaption { color: var(--muted); font-size: .875rem; max-width: 48rem; }
.plot { background: var(--panel); border-radius: .4rem; width: 100%; overflow: hidden; }
details { margin: .75rem 0; }
summary { cursor: pointer; }
article { border: 1px solid var(--line); border-radius: .5rem; padding: .25rem 1rem 1rem; margin: 1.5rem 0; }
.turn { display: flex; flex-wrap: wrap; gap: .4rem; margin: .5rem 0; }
button { font: inherit; font-size: .875rem; color: var(--text); background: var(--panel); cursor: pointer;
  border: 1px solid var(--line); border-radius: .35rem; padding: .3rem .7rem; min-height: 2rem; }
code { font-size: .85em; background: var(--panel); padding: .1rem .3rem; border-radius: .2rem; }
@media (max-width: 480px) { dl > div { grid-template-columns: 1fr; gap: 0; } article { padding: .1rem .6rem .6rem; }
  th, td { padding: .3rem .4rem; } }
@media print { nav, .turn, .skip { display: none; } }
"""
"""CSS. Colours as variables, so that the figures' script reads them too."""
