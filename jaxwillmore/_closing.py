"""What the commands say of their steps and of their end."""

from typing import Any


def progress_words(record: dict[str, Any]) -> str:
    """A line about a time step, a pseudo-time step, or a point of a branch."""
    if "t" in record:
        from .evolve import progress_text  # and JAX with it

        return progress_text(record)
    if "tau" in record:
        return (
            f"pseudo-time step {record['step']:3d}  tau {record['tau']:.2e}  "
            f"E/8πκ {record['energy_over_8pi_kappa']:.6g}  "
            f"moved {record['largest_displacement']:.2e}"
            f"{'' if record['accepted'] else '  rejected'}"
        )
    (parameter, value), energy = list(record.items())[1], record["bending_over_8pi_kappa"]
    return (
        f"point {record['point']:4d}  {parameter} {value:.6g}  E/8πκ {energy:.6g}  "
        f"negative directions {record['negative_directions']:.0f}  "
        f"angle >= {record['min_angle']:.1f}"
    )


def flow_closing(summary: dict[str, Any]) -> str:
    """The end of a run."""
    energy, phase = f"half of the integral of H^2: {summary['willmore']:.8g}", ""
    if summary.get("phase"):
        energy, phase = f"energy {summary['energy']:.8g}", f"\n{_phase_words(summary['phase'])}"
    return (
        f"{summary['status']} at t = {summary['t']:.6g} after {summary['steps']} steps "
        f"({summary['rejected_steps']} rejected, {summary['wall_seconds']:.1f} s)\n"
        f"{_new_meshes(summary.get('remeshings', []))}"
        f"{energy}, area {summary['area']:.6g}, "
        f"volume {summary['volume']:.6g}, reduced volume {summary['reduced_volume']:.6f}{phase}"
    )


def _new_meshes(remeshings: list[dict[str, Any]]) -> str:
    if not remeshings:
        return ""
    count, plural = len(remeshings), len(remeshings) > 1
    steps = ", ".join(str(new["step"]) for new in remeshings[:8]) + (", ..." if count > 8 else "")
    change = sum(new["energy"] for new in remeshings)
    return (
        f"{count} new mesh{'es' * plural}, after step{'s' * plural} {steps}; "
        f"the energy changed by {change:+.2g} of its size in all\n"
    )


def _phase_words(phase: dict[str, Any]) -> str:
    return (
        f"concentration from {phase['smallest']:.4g} to {phase['largest']:.4g}, mean "
        f"{phase['mean']:.6g}, {phase['domains']} domains with c > 1/2, length of c = 1/2 "
        f"{phase['interface_length']:.6g}"
    )


def equilibrium_closing(summary: dict[str, Any]) -> str:
    """The end of the search for an equilibrium."""
    return (
        f"{summary['status']} after {summary['steps']} pseudo-time steps "
        f"({summary['wall_seconds']:.1f} s)\n{_shape_words(summary)}"
    )


def branch_closing(summary: dict[str, Any]) -> str:
    """The end of a branch."""
    end, name = summary["ended_at"], summary["parameter"]
    where = "" if end is None else f" at {name} = {end[name]:.6g}"
    events = "".join(f"\npoint {e['point']}: {e['words']}" for e in summary["events"])
    return (
        f"{summary['status']}{where} after {summary['points']} points "
        f"({summary['wall_seconds']:.1f} s){events}\nlast: {_shape_words(summary)}"
    )


def fit_closing(summary: dict[str, Any]) -> list[str]:
    """The end of a fit: verdict, intervals, and what the data do not tell."""
    right = summary["intervals_95_if_the_model_were_right"]
    wider = summary.get("intervals_95_of_the_discrepancy", {})
    lines = [f"verdict: {summary['verdict']}"]
    for name, (low, high) in right.items():
        line = f"{name}: {low:.6g} to {high:.6g} (95 %, if the model were right)"
        if name in wider:
            line += f", {wider[name][0]:.6g} to {wider[name][1]:.6g} (model discrepancy)"
        lines.append(line)
    return lines + list(summary["in_words"])


def _shape_words(summary: dict[str, Any]) -> str:
    negative, of = summary["negative_directions"], summary["multipliers"]
    stable = "stability not known" if negative is None else f"{negative} negative directions"
    energy, phase = f"E/8πκ {summary['bending_over_8pi_kappa']:.8g}", ""
    if summary.get("phase"):
        energy, phase = f"energy {summary['energy']:.8g}", f"\n{_phase_words(summary['phase'])}"
    return (
        f"{energy}, reduced volume "
        f"{summary['reduced_volume']:.6f}, {stable}, tension {of['tension']:.6g}, "
        f"pressure {of['pressure']:.6g}{phase}"
    )
