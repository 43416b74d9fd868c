"""What is kept from run to run: exported programs, stages, and records to store them."""

from ._exported import code_hash as code_hash, machine as machine
from ._programs import (
    cached_jit as cached_jit,
    free_programs as free_programs,
    make_room as make_room,
    optimised_jit as optimised_jit,
    preload_programs as preload_programs,
    programs_recorded as programs_recorded,
    small_jit as small_jit,
)
from ._records import (
    Stand as Stand,
    UnreadableRecord as UnreadableRecord,
    different as different,
    digest as digest,
    read_records as read_records,
    write_records as write_records,
)
from ._stages import cached_stage as cached_stage
