/* musl asks for it where long double has more bits than double; here it has not. */
