"""The findings of a diagnosis as text and as a page: sentences, tables and pictures."""

from skat.diagnosis.report.page import Report

__all__ = ["Report"]
