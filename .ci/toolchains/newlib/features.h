/* musl asks for it; what it needs stands in kc_musl_names.h. */
