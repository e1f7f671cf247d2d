def test_a_fit_is_not_drawn_where_its_rows_were_left_out() -> None:
    """Rows at 0, 1, 2, 6, 7 steps: a gap before the row at 6, none elsewhere."""
    from feeddrive.plot.identification import _apart

    time, values = _apart(0.01 * np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.arange(5.0))
    np.testing.assert_allclose(time, 0.01 * np.array([0.0, 1.0, 2.0, 6.0, 6.0, 7.0]))
    np.testing.assert_array_equal(values, [0.0, 1.0, 2.0, np.nan, 3.0, 4.0])
    assert _apart(np.array([0.3]), np.array([1.0]))[0].size == 1
