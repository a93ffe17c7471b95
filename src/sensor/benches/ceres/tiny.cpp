// Ceres' header-only solver for small dense problems, for this machine's processor and with memory kept from solve to solve.

#if !__has_include(<ceres/tiny_solver.h>) || !__has_include(<Eigen/Dense>)
#error PEER_MISSING
#endif
#include <Eigen/Dense>
#include <ceres/tiny_solver.h>

#include "statement.h"

struct Function {
    using Scalar = double;
    enum { NUM_RESIDUALS = Eigen::Dynamic, NUM_PARAMETERS = Eigen::Dynamic };
    const Pixel* pixel;
    mutable Point point;

    int NumResiduals() const { return pixel->rows(); }
    int NumParameters() const { return pixel->knots; }
    bool operator()(const double* u, double* residuals, double* jacobian) const {
        const bool is_finite = point.residuals(*pixel, u, residuals);
        if (jacobian != nullptr) point.jacobian_by_columns(*pixel, jacobian);
        return is_finite;
    }
};

int main(int argc, char** argv) {
    Function function;
    // LLT is blocked and so faster than the default LDLT from some tens of unknowns on.
    ceres::TinySolver<Function, Eigen::LLT<Eigen::MatrixXd>> solver;
    solver.options.max_num_iterations = 200;
    // Absolute here, and of twice the cost: costs are 1 to 1,000.
    solver.options.function_tolerance = 1e-6;
    solver.options.parameter_tolerance = 1e-6;
    const Peer tiny = [&](Pixel& pixel, int least, double seconds) {
        return fastest(least, seconds, [&](Timed& timed) {
            const double begin = processor_s();
            fill_exposed(pixel);
            function.pixel = &pixel;
            Eigen::VectorXd u = Eigen::Map<Eigen::VectorXd>(pixel.start.data(), pixel.knots);
            const double ready = processor_s();
            timed.iterations = solver.Solve(function, &u).iterations;
            timed.solve_s = processor_s() - ready;
            timed.setup_s = ready - begin;
            timed.u.assign(u.data(), u.data() + u.size());
        });
    };
    return run(argc, argv, {{"tiny", tiny}});
}
