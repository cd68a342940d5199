"""The interpretation tree as a learner walks it, with a prior and without; policies as associators and relocators."""
