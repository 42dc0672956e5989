error: SplineSeries: a degree from 2 on and more knots were expected, and 3 and 3 came; give for instance degree 5 and 20 knots
