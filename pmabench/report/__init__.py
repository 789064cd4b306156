"""Tables, figures and the characterisation report."""
