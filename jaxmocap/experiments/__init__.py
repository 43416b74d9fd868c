"""Experiments: captures x methods x settings x seeds, done once each, as one table with statistics and a report."""

from ._batched import BatchedSearch as BatchedSearch, SearchBatch as SearchBatch
from ._bench import Benchmark as Benchmark, bench as bench, summary_lines as summary_lines
from ._gate import (
    Figure as Figure,
    complaints as complaints,
    figure as figure,
    figures_of as figures_of,
    read_baseline as read_baseline,
    worse as worse,
    write_figures as write_figures,
)
from ._paper import (
    ablation as ablation,
    comparison as comparison,
    given as given,
    paper as paper,
    varied as varied,
    without as without,
)
from ._perform import perform as perform
from ._report import error_curves as error_curves, write_report as write_report
from ._run import Inputs as Inputs, Run as Run, Trial as Trial
from ._sensitivity import Sensitivity as Sensitivity, newton as newton, sensitivity as sensitivity
from ._statistics import (
    Difference as Difference,
    Summary as Summary,
    compare as compare,
    fewest_pairs as fewest_pairs,
    paired_difference as paired_difference,
    summary as summary,
)
from ._suite import (
    STORIES as STORIES,
    CaptureSpec as CaptureSpec,
    film as film,
    story as story,
)
from ._sweep import read_record as read_record, sweep as sweep
from ._tables import (
    COLUMNS as COLUMNS,
    Table as Table,
    rows_of as rows_of,
    tables_of as tables_of,
    write_frames as write_frames,
    write_table as write_table,
)
