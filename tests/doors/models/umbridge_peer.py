"""Models served by the reference implementation of UM-Bridge, with all derivatives and with Evaluate alone."""

import sys

import umbridge


class Bare(umbridge.Model):
    def get_input_sizes(self, config):
        return [2]

    def get_output_sizes(self, config):
        return [3]

    def __call__(self, parameters, config=None):
        x, y = parameters[0]
        return [[x * x, x * y, y]]

    def supports_evaluate(self):
        return True


class Whole(Bare):
    def gradient(self, out_wrt, in_wrt, parameters, sens, config=None):
        x, y = parameters[0]
        return [2 * x * sens[0] + y * sens[1], x * sens[1] + sens[2]]

    def apply_jacobian(self, out_wrt, in_wrt, parameters, vec, config=None):
        x, y = parameters[0]
        return [2 * x * vec[0], y * vec[0] + x * vec[1], vec[1]]

    def apply_hessian(self, out_wrt, in_wrt1, in_wrt2, parameters, sens, vec, config=None):
        return [2 * sens[0] * vec[0] + sens[1] * vec[1], sens[1] * vec[0]]

    supports_gradient = supports_apply_jacobian = supports_apply_hessian = Bare.supports_evaluate


if __name__ == "__main__":
    umbridge.serve_models([Whole("whole"), Bare("bare")], int(sys.argv[1]))
