"""Log evidence and its gradient by (log variance, log lengths) with GPyTorch: product of Matérn 3/2, noise fixed.

Its iterative approximations are switched off: it uses a Cholesky decomposition.
"""

import os
from collections.abc import Mapping
from typing import Any

from worker import CORES, Task, serve


def prepare(content: Mapping[str, Any]) -> Task:
    import gpytorch
    import torch

    torch.set_num_threads(int(os.environ.get(CORES, "1")))
    x, y = torch.from_numpy(content["x"]), torch.from_numpy(content["y"])
    factors = [gpytorch.kernels.MaternKernel(nu=1.5, active_dims=[d]).double() for d in range(x.shape[1])]
    kernel = gpytorch.kernels.ScaleKernel(gpytorch.kernels.ProductKernel(*factors)).double()
    for factor, length in zip(factors, content["lengths"], strict=True):
        factor.lengthscale = float(length)
    kernel.outputscale = float(content["variance"])
    likelihood = gpytorch.likelihoods.GaussianLikelihood().double()
    likelihood.noise = float(content["nugget"])
    likelihood.raw_noise.requires_grad_(False)

    class Process(gpytorch.models.ExactGP):
        def __init__(self) -> None:
            super().__init__(x, y, likelihood)
            self.mean_module, self.covar_module = gpytorch.means.ZeroMean(), kernel

        def forward(self, points: torch.Tensor) -> Any:
            return gpytorch.distributions.MultivariateNormal(self.mean_module(points), self.covar_module(points))

    process = Process().double().train()
    marginal = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, process)
    raw = [kernel.raw_outputscale, *(factor.raw_lengthscale for factor in factors)]

    def task() -> list[float]:
        for parameter in raw:
            parameter.grad = None
        with (
            gpytorch.settings.fast_computations(covar_root_decomposition=False, log_prob=False, solves=False),
            gpytorch.settings.max_cholesky_size(10**9),
            gpytorch.settings.cholesky_jitter(double_value=0.0),
        ):
            value = len(y) * marginal(process(x), y)
        value.backward()
        return [float(value.detach()), *(by_logarithm(parameter) for parameter in raw)]

    def by_logarithm(parameter: torch.nn.Parameter) -> float:
        """Return d/d log softplus(r) from d/dr."""
        soft = torch.nn.functional.softplus(parameter.detach())
        return float(parameter.grad * soft / torch.sigmoid(parameter.detach()))

    return task


if __name__ == "__main__":
    serve(("gpytorch", "torch"), prepare)
