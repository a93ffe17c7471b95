// Ceres as Debian builds it: dense over u, by normal equations and by QR; and sparse, over a chain of small states.

#if !__has_include(<ceres/ceres.h>) || !__has_include(<Eigen/Core>)
#error PEER_MISSING
#endif
#include <ceres/ceres.h>

#include "statement.h"

// All rows in one block over one block of N unknowns: nothing of the modelling layer is paid more than once.
class Dense : public ceres::CostFunction {
public:
    explicit Dense(const Pixel& pixel) : pixel_(pixel) {
        set_num_residuals(pixel.rows());
        mutable_parameter_block_sizes()->push_back(pixel.knots);
    }
    bool Evaluate(double const* const* u, double* residuals, double** jacobians) const override {
        const bool is_finite = point_.residuals(pixel_, u[0], residuals);
        if (jacobians != nullptr && jacobians[0] != nullptr) point_.jacobian_by_rows(pixel_, jacobians[0]);
        return is_finite;
    }

private:
    const Pixel& pixel_;
    mutable Point point_;
};

// The chain: each knot has a state (u, V, A), with A the charge of the exposure that is open at it, as weighted DN.
// State equations are rows of a weight so large that they hold: this makes J^T J block tridiagonal whatever the exposures.
// Stiff at once, the search creeps along curved equations (100 iterations and more); loose first and then stiff, 5 or 6 do.
constexpr double LOOSE = 10.0, STIFF = 1e4;
double stiffness = STIFF;
using State = double const* const*;

// EVS row, V's state equation and A's, from one knot to the next.
class Interval : public ceres::SizedCostFunction<3, 3, 3> {
public:
    Interval(const Pixel& pixel, int k, double kept, double exposed) : pixel_(pixel), k_(k), kept_(kept), exposed_(exposed) {}
    bool Evaluate(State states, double* residuals, double** jacobians) const override {
        const double *before = states[0], *now = states[1], root = pixel_.root_evs_weight;
        const double lit = std::exp(before[0]);
        const Settling at = settling(pixel_, pixel_.t[k_] - pixel_.t[k_ - 1], pixel_.tau_at_end ? std::exp(now[0]) : lit);
        const double drive = now[0] - before[1], step = now[1] - before[1];
        residuals[0] = root * (pixel_.steps[k_] - step);
        residuals[1] = stiffness * root * (step - at.gamma * drive);
        residuals[2] = stiffness * (now[2] - kept_ * before[2] - exposed_ * lit);
        if (jacobians == nullptr) return std::isfinite(residuals[1] + residuals[2]);
        const double by_tau = -stiffness * root * at.slope * drive, gamma = stiffness * root * at.gamma;
        if (double* j = jacobians[0]) {
            const double rows[] = {0, root, 0, pixel_.tau_at_end ? 0 : by_tau, gamma - stiffness * root, 0, -stiffness * exposed_ * lit, 0, -stiffness * kept_};
            std::copy(rows, rows + 9, j);
        }
        if (double* j = jacobians[1]) {
            const double rows[] = {0, -root, 0, -gamma + (pixel_.tau_at_end ? by_tau : 0), stiffness * root, 0, 0, 0, stiffness};
            std::copy(rows, rows + 9, j);
        }
        return std::isfinite(residuals[1] + residuals[2]);
    }

private:
    const Pixel& pixel_;
    int k_;
    double kept_, exposed_;
};

// V = u and A = the charge before the first knot.
class First : public ceres::SizedCostFunction<2, 3> {
public:
    First(double root, double exposed) : root_(root), exposed_(exposed) {}
    bool Evaluate(State states, double* residuals, double** jacobians) const override {
        const double lit = std::exp(states[0][0]);
        residuals[0] = stiffness * root_ * (states[0][1] - states[0][0]);
        residuals[1] = stiffness * (states[0][2] - exposed_ * lit);
        if (jacobians != nullptr && jacobians[0] != nullptr) {
            const double rows[] = {-stiffness * root_, stiffness * root_, 0, -stiffness * exposed_ * lit, 0, stiffness};
            std::copy(rows, rows + 6, jacobians[0]);
        }
        return std::isfinite(lit);
    }

private:
    double root_, exposed_;
};

// A frame's row, at the knot that holds when its exposure ends.
class Read : public ceres::SizedCostFunction<1, 3> {
public:
    Read(double wanted, double kept, double exposed) : wanted_(wanted), kept_(kept), exposed_(exposed) {}
    bool Evaluate(State states, double* residuals, double** jacobians) const override {
        const double charge = exposed_ * std::exp(states[0][0]);
        residuals[0] = wanted_ - kept_ * states[0][2] - charge;
        if (jacobians != nullptr && jacobians[0] != nullptr) {
            const double row[] = {-charge, 0, -kept_};
            std::copy(row, row + 3, jacobians[0]);
        }
        return std::isfinite(charge);
    }

private:
    double wanted_, kept_, exposed_;
};

// Which exposure is open at knot k (began before, ends after), or -1. Exposures of one pixel do not overlap.
int open_at(const Pixel& pixel, int k) {
    for (int l = 0; l < pixel.frames; ++l)
        if (pixel.exposures[l].start < pixel.t[k] && pixel.t[k] < pixel.exposures[l].end) return l;
    return -1;
}

ceres::Problem::Options problem_options() {
    ceres::Problem::Options options;
    options.disable_all_safety_checks = true;
    return options;
}

void add_chain(const Pixel& pixel, ceres::Problem& problem, std::vector<double>& states) {
    const int n = pixel.knots;
    states.assign(3 * n, 0.0);
    int open = open_at(pixel, 0);
    const double exposed = open < 0 ? 0.0 : std::sqrt(pixel.exposures[open].weight) * pixel.gain * (pixel.t[0] - pixel.exposures[open].start);
    states[0] = states[1] = pixel.start[0];
    states[2] = exposed * std::exp(pixel.start[0]);
    problem.AddResidualBlock(new First(pixel.root_evs_weight, exposed), nullptr, &states[0]);
    for (int k = 1; k < n; ++k) {
        const int before = open;
        open = open_at(pixel, k);
        double kept = 0.0, exposed = 0.0;
        if (open >= 0) {
            const Frame& frame = pixel.exposures[open];
            kept = before == open ? 1.0 : 0.0;
            exposed = std::sqrt(frame.weight) * pixel.gain * (pixel.t[k] - std::max(pixel.t[k - 1], frame.start));
        }
        // The start obeys the state equations.
        const double *last = &states[3 * (k - 1)], u = pixel.start[k];
        const double lit = std::exp(last[0]);
        const Settling at = settling(pixel, pixel.t[k] - pixel.t[k - 1], pixel.tau_at_end ? std::exp(u) : lit);
        states[3 * k] = u;
        states[3 * k + 1] = last[1] + at.gamma * (u - last[1]);
        states[3 * k + 2] = kept * last[2] + exposed * lit;
        problem.AddResidualBlock(new Interval(pixel, k, kept, exposed), nullptr, &states[3 * (k - 1)], &states[3 * k]);
    }
    for (const Frame& frame : pixel.exposures) {
        int k = 0;
        while (k + 1 < n && pixel.t[k + 1] < frame.end) ++k;
        const bool began_before = k > 0 ? frame.start < pixel.t[k] : frame.start < pixel.t[0] && pixel.t[0] < frame.end;
        const double from = began_before ? pixel.t[k] : frame.start, root = std::sqrt(frame.weight);
        problem.AddResidualBlock(new Read(root * (frame.dn - pixel.black), began_before ? 1.0 : 0.0, root * pixel.gain * (frame.end - from)), nullptr, &states[3 * k]);
    }
}

ceres::Solver::Options solver_options(ceres::LinearSolverType type) {
    ceres::Solver::Options options;
    options.linear_solver_type = type;
    options.num_threads = 1;
    options.logging_type = ceres::SILENT;
    options.max_num_iterations = 200;
    options.function_tolerance = 1e-8;
    options.parameter_tolerance = 1e-6;
    options.gradient_tolerance = 1e-10;
    // Nearly undamped from the first step on: these problems are benign, and damping only delays.
    options.initial_trust_region_radius = 1e12;
    return options;
}

// Steps tried; Ceres counts the start as one.
int iterations(const ceres::Solver::Summary& summary) { return summary.num_successful_steps + summary.num_unsuccessful_steps - 1; }

Peer dense(ceres::LinearSolverType type) {
    const ceres::Solver::Options options = solver_options(type);
    return [options](Pixel& pixel, int least, double seconds) {
        return fastest(least, seconds, [&](Timed& timed) {
            const double begin = processor_s();
            fill_exposed(pixel);
            timed.u = pixel.start;
            ceres::Problem problem(problem_options());
            problem.AddResidualBlock(new Dense(pixel), nullptr, timed.u.data());
            const double ready = processor_s();
            ceres::Solver::Summary summary;
            ceres::Solve(options, &problem, &summary);
            timed.solve_s = processor_s() - ready;
            timed.setup_s = ready - begin;
            timed.iterations = iterations(summary);
        });
    };
}

Timed chain(Pixel& pixel, int least, double seconds) {
    ceres::Solver::Options first = solver_options(ceres::SPARSE_NORMAL_CHOLESKY), last = first;
    first.function_tolerance = 1e-3;
    std::vector<double> states;
    return fastest(least, seconds, [&](Timed& timed) {
        const double begin = processor_s();
        ceres::Problem problem(problem_options());
        add_chain(pixel, problem, states);
        const double ready = processor_s();
        ceres::Solver::Summary summary;
        stiffness = LOOSE;
        ceres::Solve(first, &problem, &summary);
        timed.iterations = iterations(summary);
        stiffness = STIFF;
        ceres::Solve(last, &problem, &summary);
        timed.solve_s = processor_s() - ready;
        timed.setup_s = ready - begin;
        timed.iterations += iterations(summary);
        timed.u.resize(pixel.knots);
        for (int k = 0; k < pixel.knots; ++k) timed.u[k] = states[3 * k];
    });
}

int main(int argc, char** argv) {
    return run(argc, argv, {{"dense", dense(ceres::DENSE_NORMAL_CHOLESKY)}, {"qr", dense(ceres::DENSE_QR)}, {"chain", chain}});
}
