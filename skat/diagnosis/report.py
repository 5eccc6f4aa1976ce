"""The findings of a diagnosis as text and as a page."""


class Report:
    """The findings of a fitted diagnosis.

    Parameters
    ----------
    diagnosis : SimulationDiagnosis
        Fitted.
    log : Log
        The rows it was fitted to.
    """

    def __init__(self, diagnosis, log):
        self.diagnosis, self.log = diagnosis, log

    def text(self):
        """Return the findings as lines of text."""
        diagnosis = self.diagnosis
        lines = [f"Verdict: {diagnosis.verdict_}"]
        for cause in diagnosis.causes_:
            low, high = cause.interval
            aliases = f"; cannot be told from {', '.join(cause.aliases)}" if cause.aliases else ""
            lines.append(
                f"  {cause.name} = {cause.value:.4g} {cause.unit} (95 %: {low:.4g} to {high:.4g}){aliases}"
            )
        if diagnosis.verdict_ == "unexplained":
            lines.append(f"  {diagnosis.remainder_.sentence}")
        return "\n".join(lines)
