"""Atomic writing and the folders of results."""

from ._atomic import (
    atomic_folder as atomic_folder,
    atomic_path as atomic_path,
    json_text as json_text,
    keep_newest as keep_newest,
    npz_bytes as npz_bytes,
    plain as plain,
    write_bytes as write_bytes,
    write_csv as write_csv,
    write_json as write_json,
    write_text as write_text,
)
from ._folder import (
    check_output as check_output,
    claim_output as claim_output,
    free_name as free_name,
    is_clutter as is_clutter,
)
