"""The commands as functions with declared requests, one module each; `command.py` lists them."""

# written by `make stubs`

from feeddrive.workflow.adjust import adjust as adjust
from feeddrive.workflow.benchmark import benchmark as benchmark
from feeddrive.workflow.certify import certify as certify
from feeddrive.workflow.certify import read_certificate as read_certificate
from feeddrive.workflow.certify import write_certificate as write_certificate
from feeddrive.workflow.channels import channels as channels
from feeddrive.workflow.check import check as check
from feeddrive.workflow.circle import circle as circle
from feeddrive.workflow.cogging import cogging as cogging
from feeddrive.workflow.command import Outcome as Outcome
from feeddrive.workflow.commission import commission as commission
from feeddrive.workflow.compare import compare as compare
from feeddrive.workflow.doctor import doctor as doctor
from feeddrive.workflow.excite import excite as excite
from feeddrive.workflow.export import export as export
from feeddrive.workflow.export import verify as verify
from feeddrive.workflow.follow import follow as follow
from feeddrive.workflow.force import force as force
from feeddrive.workflow.frf import frf as frf
from feeddrive.workflow.friction import friction as friction
from feeddrive.workflow.identify import identify as identify
from feeddrive.workflow.learn import iterate as iterate
from feeddrive.workflow.learn import prefilter as prefilter
from feeddrive.workflow.lobes import lobes as lobes
from feeddrive.workflow.new import new as new
from feeddrive.workflow.plan import plan as plan
from feeddrive.workflow.play import listen as listen
from feeddrive.workflow.play import play as play
from feeddrive.workflow.play import virtual_drive as virtual_drive
from feeddrive.workflow.reproduce import reproduce as reproduce
from feeddrive.workflow.run_job import cosimulate as cosimulate
from feeddrive.workflow.run_job import demo as demo
from feeddrive.workflow.run_job import run as run
from feeddrive.workflow.run_job import write_results as write_results
from feeddrive.workflow.setpath import setpath as setpath
from feeddrive.workflow.sweep import sweep as sweep
from feeddrive.workflow.tour import tour as tour
from feeddrive.workflow.travel import travel as travel
from feeddrive.workflow.tune import tune as tune
