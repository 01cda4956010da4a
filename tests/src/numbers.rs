//! Comparisons that say what they compared.

/// |value − expected| ≤ `tolerance`, in the unit of the values.
///
/// # Panics
/// Where it is not so; NaN never is.
#[track_caller]
pub fn assert_close(what: &str, value: f64, expected: f64, tolerance: f64) {
    let error = (value - expected).abs();
    assert!(error <= tolerance, "{what}: {value} is {error:e} from {expected}, more than {tolerance:e}");
}

/// |value − expected| ≤ `tolerance` · |expected|; an expected zero must be met exactly.
///
/// # Panics
/// Where it is not so; NaN never is.
#[track_caller]
pub fn assert_relative(what: &str, value: f64, expected: f64, tolerance: f64) {
    assert_close(what, value, expected, tolerance * expected.abs());
}
