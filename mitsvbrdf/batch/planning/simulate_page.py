"""What :mod:`.simulate` found, as Markdown and as a chart. Both show its figures and compute none but
shares.
"""

from __future__ import annotations

from collections.abc import Mapping

from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from ...report.colours import CHART_GRID, CHART_LINES, CHART_QUIET, CHART_TEXT

PERCENT = ("slow_nodes", "hangs", "refused")


def page(record: Mapping) -> str:
    """The figures as Markdown."""
    cluster, load, runs = record["cluster"], record["load"], record["runs"]
    first = runs[0]
    lines = [
        "# A batch on many workers, simulated", "",
        "Written by `python -m mitsvbrdf.batch.planning.simulate` from `batch-simulation.json`. Nothing "
        "here ran on a "
        "cluster: the loop, the scheduler and the manifest are those of `mitsvbrdf batch`, workers and "
        "clock are virtual.", "",
        f"{load['captures']:,} captures on {cluster['workers']:,} workers, {cluster['nodes']} nodes. A "
        "usual fit takes "
        f"{load['seconds']:.1f} s, {load['large']:.0%} of the captures {load['larger']:.1f} times that. "
        "*Ideal*: all workers "
        "fit all the time at full speed, and nothing fails. *Tail*: from when nothing waits for the first "
        "time until the end. "
        "*Thrown away*: seconds of fits that brought no result, of all seconds of fits. "
        "Captures go largest first, as the scheduler has it, where no other order is named.", "",
        "| case | makespan, min | captures an hour | of the ideal | tail, min | attempts | thrown away | "
        "done | failed | lost "
        "or twice | supervisor busy | MB/s |", "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|"]
    for run in runs:
        lines.append(f"| {run['case']} | {run['makespan'] / 60:.1f} | {run['per_hour']:,.0f} | "
                     f"{run['share']:.1%} | "
                     f"{run['tail'] / 60:.1f} | {run['attempts']:,} | {run['lost_share']:.2%} | "
                     f"{run['done']:,} | "
                     f"{run['failed']:,} | {run['left'] + run['twice'] + run['done'] - run['published']:,} | "
                     f"{run['supervisor_share']:.1%} | {run['bytes'] / 1e6:,.0f} |")
    lines += ["", f"Ends of fits, and deaths, {first['case']}: " + ", ".join(
        f"{count:,} {what}" for what, count in first["ends"].items()) + ".", "",
        "## More workers", "", "![Share of the ideal and load of the supervisor over "
                               "workers](batch-simulation.svg)", "",
        "Without failures and slow nodes, ten fits for each worker; the end of so short a batch costs a "
              "share of the ideal "
        "too. The supervisor takes a fit in, notes it and hands the next one out in the milliseconds named, "
              "and is busy all "
        "the time at the number of workers under *limit*: more of them do no more.", "",
        "| supervisor, ms | workers | captures an hour | of the ideal | supervisor busy | MB/s | limit, "
              "workers |",
        "|---:|---:|---:|---:|---:|---:|---:|"]
    lines += [f"| {1e3 * row['supervisor_seconds']:.3g} | {row['workers']:,} | {row['per_hour']:,.0f} | "
              f"{row['share']:.1%} | "
              f"{row['supervisor_share']:.0%} | {row['bytes'] / 1e6:,.0f} | {row['limit']:,.0f} |"
              for row in record["sweep"]]
    if measured := record["supervisor"]:
        lines += ["", "Measured here with the real loop, its manifest on a disk: "
                      f"{1e3 * measured['fit_cpu_seconds']:.2f} ms "
                  f"of CPU for a fit ({1e3 * measured['fit_seconds']:.1f} ms of the wall clock, beside "
                  "other work on the same "
                  f"processors and disk), {measured['page_cpu_seconds']:.1f} s for the page of "
                  f"{load['captures']:,} materials."]
    lines += ["", "## Assumed", "", "| what | value |", "|---|---:|"]
    lines += [f"| {name.replace('_', ' ')} | {f'{value:.2%}' if name in PERCENT else f'{value:,.6g}'} |"
              for name, value in cluster.items()]
    return "\n".join([*lines, "", "Seconds, bytes, bytes a second; crashes, deaths an hour. `python -m "
                      "mitsvbrdf.batch.planning.simulate --help` says what each is, and takes others.", ""])


def figure(record: Mapping) -> Figure:
    """Share of the ideal and load of the supervisor over the number of workers."""
    drawing = Figure(figsize=(6, 3.2))
    panel = drawing.subplots()
    drawing.subplots_adjust(left=0.1, right=0.97, top=0.95, bottom=0.16)
    for taken, colour in zip(dict.fromkeys(row["supervisor_seconds"] for row in record["sweep"]),
                             CHART_LINES):
        rows = [row for row in record["sweep"] if row["supervisor_seconds"] == taken]
        workers = [row["workers"] for row in rows]
        for what, style, words in (("share", "-", "of the ideal"),
                                   ("supervisor_share", ":", "supervisor busy")):
            panel.plot(workers, [100 * row[what] for row in rows], style, color=colour, marker="o",
                       markersize=4, label=f"{words}, {1e3 * taken:.2g} ms a fit")
    panel.set_xscale("log")
    panel.xaxis.set_major_locator(FixedLocator(workers))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xticks(workers, [f"{number:,}" for number in workers])
    panel.set_ylim(0, 105)
    panel.set_xlabel("workers", color=CHART_TEXT, fontsize=9)
    panel.set_ylabel("per cent", color=CHART_TEXT, fontsize=9)
    panel.grid(color=CHART_GRID, linewidth=0.7)
    panel.tick_params(labelsize=8, labelcolor=CHART_TEXT, color=CHART_QUIET)
    panel.spines[["top", "right"]].set_visible(False)
    panel.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(0, 0.66))
    return drawing
