"""What pages and pictures are made of; it knows no material.

``page`` fills a template into one HTML file, ``base.html`` is the look all pages share, ``pictures`` turns
tensors into what ``<img>`` shows, ``curves`` turns a trace into what an inline SVG needs, ``canvas`` draws
sheets of pictures, ``notebook`` shows a value in a notebook, ``colours`` are those of all drawings. Numbers
flow in; nothing is computed here.
"""
