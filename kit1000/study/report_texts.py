"""Texts of a report that do not depend on its numbers."""

from __future__ import annotations

SIMULATED_MEANS = """
<ul>
<li>It may show that plan, clock, robot, records and statistics work together, and how success depends on the error of a
hand.</li>
<li>It may not show that people are faster or better with one of the conditions: that follows from the model, which was
put in by hand. It says nothing about load, so nothing is rated.</li>
<li>Its p values are those of a model against itself. Never quote them as a result about people.</li>
</ul>"""

MODELS = {
    "exact": "The operator <em>exact</em> puts every part at its true goal.",
    "paper": "The operator <em>paper</em> errs by up to 28 mm along each axis and 27.5°, as the paper assumes of a "
    "hand. It takes the time of a draft of the paper for each part, and the first proposal of a method.",
    "fitts": "The operator <em>fitts</em> aims as Fitts' law and the keystroke-level model say, with assumed lapses: "
    "5 % wrong cavities, 20 % of wrong proposals taken.",
    "careless": "The operator <em>careless</em> is <em>fitts</em> with lapses twice as frequent.",
}

METHOD = """\
<p>Within subjects: every participant meets every condition, on different tasks. Orders follow a Williams square
crossed with the sets of tasks and are fixed by the participant's number. In a task of n kits an upload may start while
the clock reads under n minutes; specification is the time in which the participant is in charge, execution that of the
simulated robot. A part counts as a success when {success}.</p>
<p>Each comparison is a difference a person, tested against zero: by t, or by Wilcoxon's signed ranks where Shapiro and
Wilk's test finds the differences not normal (α = {alpha}). Intervals: 95 % BCa, {resamples} resamples over people. d_z
is the mean difference over its standard deviation. All outcomes but the main one are secondary and not adjusted, except
the six scales of the raw NASA-TLX, after Holm. Low is good on each scale.</p>"""

STYLE = """\
:root { color-scheme: light dark; --ink: #1f2328; --soft: #5f6872; --rule: #dfe3e8; --paper: #fff; --alarm: #fff3e6;
  --edge: #c2571a; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e9ed; --soft: #9aa4af; --rule: #2c333c; --paper: #12161b;
  --alarm: #2b2016; --edge: #f2955a; } }
body { margin: 0; background: var(--paper); color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 1120px; margin: 0 auto; padding: 24px 20px 64px; }
h1 { font-size: 28px; margin: 0 0 4px; } h2 { font-size: 20px; margin: 40px 0 12px; }
.soft { color: var(--soft); font-weight: 400; } p.soft { font-size: 14px; }
.warning { background: var(--alarm); border-left: 4px solid var(--edge); padding: 4px 16px; margin: 20px 0; }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(320px, 1fr)); gap: 20px 24px;
  align-items: start; }
.figures svg { width: 100%; max-width: 420px; height: auto; }
.wide { overflow-x: auto; margin: 16px 0 4px; }
table { border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
th, td { text-align: left; padding: 6px 14px 6px 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
td { white-space: nowrap; } thead th { color: var(--soft); font-weight: 500; } tbody th { font-weight: 500; }
"""
