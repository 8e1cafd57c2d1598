"""How the service is seen from outside: metrics, request ids, access log, traces."""
