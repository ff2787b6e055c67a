"""Linear systems as matrices: poles, Riccati equations, structure, sampling."""
