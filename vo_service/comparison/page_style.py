"""How the page looks: light, in one column, readable on a phone and on paper."""

STYLE = """\
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 70rem; background: #fff; color: #1c2126;
  font: 1rem/1.55 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 1rem 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .4rem; padding-top: .6rem; border-top: 1px solid #d5dade; }
h3 { font-size: 1.05rem; margin: 1.6rem 0 .3rem; }
p, dd, figcaption { max-width: 46rem; }
p { margin: .4rem 0 .8rem; }
nav a { margin-right: 1rem; white-space: nowrap; }
a { color: #0b5cad; }
.facts, figcaption, .note { color: #4c565f; font-size: .92rem; }
.wide { overflow-x: auto; margin: .6rem 0 1rem; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #e3e7ea; text-align: right; }
td { white-space: nowrap; }
th { vertical-align: bottom; font-weight: 600; background: #f4f6f8; }
th:first-child, td:first-child, .text { text-align: left; }
.best { font-weight: 700; }
.bad { color: #a3280c; }
figure { margin: 1.2rem 0 1.8rem; }
figure img { display: block; width: 100%; min-width: 40rem; height: auto;
  border: 1px solid #e3e7ea; }
figure .wide { margin: 0; }
figcaption { margin-top: .4rem; }
dt { font-weight: 600; margin-top: .6rem; }
dd { margin: 0; }
pre { overflow-x: auto; background: #f4f6f8; padding: .8rem; font-size: .85rem; }
@media print { body { max-width: none; } nav { display: none; }
  figure, tr { break-inside: avoid; } }
"""
