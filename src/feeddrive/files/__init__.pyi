"""User files: machine and job files in TOML, measured logs, recorded runs, result directories."""

# written by `make stubs`

from feeddrive.files.columns import Column as Column
from feeddrive.files.frf import encoders as encoders
from feeddrive.files.frf import read_controllers as read_controllers
from feeddrive.files.frf import read_frf as read_frf
from feeddrive.files.frf import read_frfs as read_frfs
from feeddrive.files.frf import write_frf as write_frf
from feeddrive.files.growing import GrowingFile as GrowingFile
from feeddrive.files.growing import GrowingTable as GrowingTable
from feeddrive.files.handover import comp_text as comp_text
from feeddrive.files.handover import read_comp_file as read_comp_file
from feeddrive.files.handover import write_comp_file as write_comp_file
from feeddrive.files.handover import write_csv as write_csv
from feeddrive.files.handover import write_mat as write_mat
from feeddrive.files.job import Job as Job
from feeddrive.files.job import read_job as read_job
from feeddrive.files.log import Log as Log
from feeddrive.files.log import write_log as write_log
from feeddrive.files.machine import MachineFile as MachineFile
from feeddrive.files.machine import read_machine as read_machine
from feeddrive.files.mapping import Guess as Guess
from feeddrive.files.mapping import Mapping as Mapping
from feeddrive.files.mapping import guess_roles as guess_roles
from feeddrive.files.mapping import log_preview as log_preview
from feeddrive.files.mapping import role_doubts as role_doubts
from feeddrive.files.mapping import write_roles as write_roles
from feeddrive.files.read_log import read_arrays as read_arrays
from feeddrive.files.read_log import read_log as read_log
from feeddrive.files.read_log import read_request as read_request
from feeddrive.files.section import to_toml as to_toml
