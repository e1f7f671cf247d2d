"""User files: machine and job files in TOML, measured logs, recorded runs, result directories."""

from feeddrive.language.lazy_package import make_lazy

make_lazy(
    __name__,
    {
        "columns": "Column",
        "frf": "encoders read_controllers read_frf read_frfs write_frf",
        "growing": "GrowingFile GrowingTable",
        "handover": "comp_text read_comp_file write_comp_file write_csv write_mat",
        "job": "Job read_job",
        "log": "Log write_log",
        "machine": "MachineFile read_machine",
        "mapping": "Guess guess_roles log_preview role_doubts write_roles Mapping",
        "read_log": "read_arrays read_log read_request",
        "section": "to_toml",
    },
)
