"""What deploy/kubernetes uses of kinds that are no part of Kubernetes, as their CustomResourceDefinitions have it, and nothing else.

ScaledObject, TriggerAuthentication: config/crd/bases of kedacore/keda; the trigger's fields: keda.sh, scaler "Redis Lists".
PodMonitor: example/prometheus-operator-crd of prometheus-operator/prometheus-operator.
"""

from typing import Any

Schema = dict[str, Any]
TEXT: Schema = {"type": "string", "minLength": 1}
COUNT: Schema = {"type": "integer", "minimum": 0}
DURATION: Schema = {"type": "string", "pattern": "^[0-9]+(ms|s|m|h)$"}


def fields(required: str, **properties: Schema) -> Schema:
    """An object of these fields and no others; `required`: names with spaces between."""
    return {"type": "object", "properties": properties, "required": required.split(), "additionalProperties": False}


def rows(item: Schema) -> Schema:
    """At least one of them."""
    return {"type": "array", "items": item, "minItems": 1}


def resource(version: str, kind: str, spec: Schema) -> Schema:
    """A whole object."""
    return fields("apiVersion kind metadata spec", apiVersion={"const": version}, kind={"const": kind}, metadata=NAMED, spec=spec)


LABELS: Schema = {"type": "object", "additionalProperties": {"type": "string"}}
NAMED = fields("name", name=TEXT, namespace=TEXT, labels=LABELS, annotations=LABELS)
POLICY = fields("type value periodSeconds", type={"enum": ["Pods", "Percent"]}, value=COUNT, periodSeconds={**COUNT, "maximum": 1800})
RULES = fields("", stabilizationWindowSeconds={**COUNT, "maximum": 3600}, selectPolicy={"enum": ["Min", "Max"]}, policies=rows(POLICY))
QUEUE_LENGTH = fields(
    "address listName listLength",
    address={"type": "string", "pattern": "^[^:/]+:[0-9]+$"},
    listName=TEXT,
    listLength={"type": "string", "pattern": "^[1-9][0-9]*$"},
    enableTLS={"enum": ["true", "false"]},
)
TRIGGER = fields("type metadata", type={"const": "redis"}, metadata=QUEUE_LENGTH, authenticationRef=fields("name", name=TEXT))
BEHAVIOUR = fields("", behavior=fields("", scaleUp=RULES, scaleDown=RULES))

SCALED_OBJECT = resource(
    "keda.sh/v1alpha1",
    "ScaledObject",
    fields(
        "scaleTargetRef triggers",
        scaleTargetRef=fields("name", name=TEXT, kind=TEXT, apiVersion=TEXT),
        pollingInterval=COUNT,
        cooldownPeriod=COUNT,
        minReplicaCount=COUNT,
        maxReplicaCount=COUNT,
        fallback=fields("failureThreshold replicas", failureThreshold=COUNT, replicas=COUNT),
        advanced=fields("", horizontalPodAutoscalerConfig=BEHAVIOUR),
        triggers=rows(TRIGGER),
    ),
)
TRIGGER_AUTHENTICATION = resource(
    "keda.sh/v1alpha1",
    "TriggerAuthentication",
    fields("secretTargetRef", secretTargetRef=rows(fields("parameter name key", parameter=TEXT, name=TEXT, key=TEXT))),
)
CREDENTIALS = fields("credentials", type=TEXT, credentials=fields("name key", name=TEXT, key=TEXT))
POD_MONITOR = resource(
    "monitoring.coreos.com/v1",
    "PodMonitor",
    fields(
        "selector podMetricsEndpoints",
        selector=fields("matchLabels", matchLabels=LABELS),
        podMetricsEndpoints=rows(fields("", port=TEXT, path=TEXT, interval=DURATION, authorization=CREDENTIALS)),
    ),
)
CUSTOM = {schema["properties"]["kind"]["const"]: schema for schema in (SCALED_OBJECT, TRIGGER_AUTHENTICATION, POD_MONITOR)}
"""Schema by kind."""
