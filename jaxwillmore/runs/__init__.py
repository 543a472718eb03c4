"""Runs: what a case decides, performed, recorded and drawn in a folder of its own."""

from ._branch import CaseBranch as CaseBranch, run_branch as run_branch
from ._check import check_file as check_file
from ._doctor import diagnosis as diagnosis
from ._equilibrium import CaseEquilibrium as CaseEquilibrium, run_equilibrium as run_equilibrium
from ._fit import FitRun as FitRun, run_fit as run_fit
from ._resume import resume_case as resume_case
from ._resume_branch import resume_branch as resume_branch
from ._run import CaseRun as CaseRun, run_case as run_case
