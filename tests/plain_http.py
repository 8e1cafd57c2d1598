"""HTTP to services that speak it without TLS: the authorities that httpx would trust are not read, which takes longer than most answers."""

import ssl
from functools import partial

import httpx

NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)

Client = partial(httpx.Client, verify=NO_TLS)
get, post, request = (partial(call, verify=NO_TLS) for call in (httpx.get, httpx.post, httpx.request))
