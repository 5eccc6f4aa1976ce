"""The private names of scikit-learn that skat uses, in one place."""

from sklearn.utils._array_api import _convert_to_numpy as convert_to_numpy
from sklearn.utils._array_api import _is_numpy_namespace as is_numpy_namespace
from sklearn.utils._array_api import check_same_namespace, get_namespace_and_device, supported_float_dtypes
from sklearn.utils._indexing import _get_column_indices as column_indices
from sklearn.utils._indexing import _safe_indexing as safe_indexing
from sklearn.utils._param_validation import HasMethods, Interval, StrOptions
from sklearn.utils.validation import _check_feature_names as check_feature_names
from sklearn.utils.validation import _check_n_features as check_n_features
from sklearn.utils.validation import _check_sample_weight as check_sample_weight
from sklearn.utils.validation import _get_feature_names as feature_names

__all__ = [
    "HasMethods",
    "Interval",
    "StrOptions",
    "check_feature_names",
    "check_n_features",
    "check_same_namespace",
    "check_sample_weight",
    "column_indices",
    "convert_to_numpy",
    "feature_names",
    "get_namespace_and_device",
    "is_numpy_namespace",
    "safe_indexing",
    "supported_float_dtypes",
]
