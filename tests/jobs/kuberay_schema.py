"""Allowed content of a RayJob in jobs/kuberay.yaml: the field names of KubeRay's published API reference.

Source: the reference of ``ray.io/v1`` (RayJobSpec, RayClusterSpec, HeadGroupSpec, WorkerGroupSpec, AutoscalerOptions,
    AuthOptions) and of Kubernetes ``core/v1`` (PodSpec, Container), copied by hand. Only listed fields are accepted, so
    a misspelt or misplaced field is found without a cluster.
"""

from __future__ import annotations

from typing import Any

Schema = dict[str, Any]
TEXT: Schema = {"type": "string"}
WHOLE: Schema = {"type": "integer", "minimum": 0}
FLAG: Schema = {"type": "boolean"}
TEXTS: Schema = {"type": "object", "additionalProperties": TEXT}


def record(required: tuple[str, ...] = (), **properties: Schema) -> Schema:
    return {"type": "object", "properties": properties, "required": list(required), "additionalProperties": False}


def listed(items: Schema) -> Schema:
    return {"type": "array", "items": items, "minItems": 1}


_RESOURCES = record(requests=TEXTS, limits=TEXTS)
_SECURITY = record(
    allowPrivilegeEscalation=FLAG,
    capabilities=record(add=listed(TEXT), drop=listed(TEXT)),
    readOnlyRootFilesystem=FLAG,
    runAsNonRoot=FLAG,
    runAsUser=WHOLE,
)
_CONTAINER = record(
    ("name", "image", "resources"),
    name=TEXT,
    image=TEXT,
    imagePullPolicy={"enum": ["Always", "IfNotPresent", "Never"]},
    env=listed(record(("name", "value"), name=TEXT, value=TEXT)),
    envFrom=listed(record(secretRef=record(("name",), name=TEXT, optional=FLAG))),
    resources=_RESOURCES,
    securityContext=_SECURITY,
    volumeMounts=listed(record(("name", "mountPath"), name=TEXT, mountPath=TEXT, readOnly=FLAG)),
)
_POD = record(
    ("containers",),
    automountServiceAccountToken=FLAG,
    containers=listed(_CONTAINER),
    nodeSelector=TEXTS,
    serviceAccountName=TEXT,
    volumes={"type": "array"},
)
_TEMPLATE = record(("spec",), metadata=record(labels=TEXTS, annotations=TEXTS), spec=_POD)
_HEAD = record(
    ("template",),
    template=_TEMPLATE,
    rayStartParams=TEXTS,
    serviceType={"enum": ["ClusterIP", "NodePort", "LoadBalancer"]},
    enableIngress=FLAG,
)
_WORKERS = record(
    ("groupName", "template"),
    groupName=TEXT,
    replicas=WHOLE,
    minReplicas=WHOLE,
    maxReplicas=WHOLE,
    numOfHosts=WHOLE,
    idleTimeoutSeconds=WHOLE,
    rayStartParams=TEXTS,
    template=_TEMPLATE,
)
_CLUSTER = record(
    ("headGroupSpec", "workerGroupSpecs", "rayVersion", "authOptions"),
    rayVersion=TEXT,
    authOptions=record(("mode",), mode={"enum": ["disabled", "token"]}, secretName=TEXT, enableK8sTokenAuth=FLAG),
    enableInTreeAutoscaling=FLAG,
    autoscalerOptions=record(
        idleTimeoutSeconds=WHOLE,
        upscalingMode={"enum": ["Default", "Aggressive", "Conservative"]},
        version={"enum": ["v1", "v2"]},
        resources=_RESOURCES,
    ),
    headGroupSpec=_HEAD,
    workerGroupSpecs=listed(_WORKERS),
)
RAY_JOB = record(
    ("apiVersion", "kind", "metadata", "spec"),
    apiVersion={"const": "ray.io/v1"},
    kind={"const": "RayJob"},
    metadata=record(name=TEXT, generateName=TEXT, namespace=TEXT, labels=TEXTS),
    spec=record(
        ("entrypoint", "rayClusterSpec"),
        entrypoint=TEXT,
        submissionMode={"enum": ["K8sJobMode", "HTTPMode", "InteractiveMode", "SidecarMode"]},
        shutdownAfterJobFinishes=FLAG,
        ttlSecondsAfterFinished=WHOLE,
        activeDeadlineSeconds=WHOLE,
        backoffLimit=WHOLE,
        runtimeEnvYAML=TEXT,
        rayClusterSpec=_CLUSTER,
    ),
)
"""JSON Schema of the whole RayJob."""
