"""The report functions of all types of results, listed by name, so that they are imported only by `result.report()`.

The analysis packages thus do not depend on reports.  A command adds facts to its report, such as the source of a log.
"""

from importlib import import_module

from feeddrive.language.table import report_of

# module and class of a result -> its report function
REPORTS = {
    "benchmark.benchmark:Benchmark": "benchmark.report:benchmark_report",
    "certificate.certificate:Certificate": "workflow.certify:certificate_report",
    "certificate.travel_proof:TravelProof": "workflow.travel:proof_report",
    "commissioning.record:Commissioned": "workflow.commission_report:commission_report",
    "comparison.compare:Comparison": "comparison.report:comparison_report",
    "identification.cogging:CoggingFit": "workflow.cogging:cogging_report",
    "identification.excitation.excitation:Excitation": "workflow.excite:excitation_report",
    "identification.excitation.frequency_estimate:FrequencyEstimate": "workflow.frf:estimate_report",
    "identification.friction_curve:FrictionCurve": "workflow.friction:friction_report",
    "identification.motion.identify:Identified": "workflow.identify:identified_report",
    "identification.motion.pooled:IdentifiedLogs": "workflow.identify:pooled_report",
    "identification.response.plant_fit:AxisFits": "workflow.identify_responses:fit_report",
    "identification.response.modal_fit:ModalFit": "workflow.identify_responses:fit_report",
    "learning.part_correction:CorrectedProgram": "workflow.setpath:corrected_report",
    "learning.part_log:LearnedPart": "workflow.setpath:learned_report",
    "machining.lobes:Lobes": "workflow.lobes:lobes_report",
    "papers.claims:Experiment": "papers.claims:paper_report",
    "path.planned:Planned": "report.machining_report:plan_report",
    "study.answers:Answers": "study.page:study_report",
    "study.robust:Robust": "workflow.tune_study:robust_report",
    "tuning.travel:TunedTravel": "workflow.travel:tuned_travel_report",
    "tuning.tune:Tuned": "workflow.tune_files:tuned_report",
    "workflow.circle:MeasuredCircle": "workflow.circle:measured_circle_report",
    "jobs.run_laws:JobResult": "jobs.run_laws:job_report",
}


def register_report(kind: type) -> None:
    """Register the report functions that are listed for a type of result and its base classes."""
    for base in kind.__mro__:
        name = f"{base.__module__.removeprefix('feeddrive.')}:{base.__qualname__}"
        if name in REPORTS and base not in report_of.registry:
            module, function = REPORTS[name].split(":")

            # bound as defaults: a closure would read the last values of the loop
            def report(result: object, module: str = module, function: str = function) -> object:
                return getattr(import_module(f"feeddrive.{module}"), function)(result)

            report_of.register(base, report)
