// One pixel's problem, stated for the peers from its equations, and what every peer shares: reading, writing, time.
//
// Unknown is u_k = ln i_k at each of N knots. V(0) = u_0 and V(k) = V(k-1) + gamma_k (u_k - V(k-1)) with
// gamma_k = 1 - exp(-dt_k / tau_k), tau_k = tau_0 + alpha / i, where i is taken at the interval's start or end.
// Rows: sqrt(w_evs) (step_k - (V(k) - V(k-1))), and sqrt(w_l) (dn_l - black - gain * integral of i over exposure l),
// where i_k holds from knot k to knot k+1, the first also before, the last for ever. See docs/physics.md, Eqs. (1) to (13).

#pragma once

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <functional>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

struct Frame {
    double start, end, dn, weight;
};

struct Pixel {
    int knots, frames;
    bool tau_at_end;
    double root_evs_weight, tau_0, alpha, black, gain;
    std::vector<double> t, steps, start;
    std::vector<Frame> exposures;
    // DN per unit of photocurrent that a knot adds to a frame, times the root of the frame's weight; a row per frame.
    std::vector<double> exposed;

    int rows() const { return knots - 1 + frames; }
};

inline bool read(std::istream& in, Pixel& pixel) {
    double evs_weight;
    if (!(in >> pixel.knots >> pixel.frames >> pixel.tau_at_end >> evs_weight >> pixel.tau_0 >> pixel.alpha >> pixel.black >> pixel.gain)) return false;
    pixel.root_evs_weight = std::sqrt(evs_weight);
    for (auto* column : {&pixel.t, &pixel.steps, &pixel.start}) {
        column->resize(pixel.knots);
        for (double& value : *column) in >> value;
    }
    pixel.exposures.resize(pixel.frames);
    for (Frame& frame : pixel.exposures) in >> frame.start >> frame.end >> frame.dn >> frame.weight;
    return bool(in);
}

// Fills the table of overlaps: part of a pixel's set-up.
inline void fill_exposed(Pixel& pixel) {
    pixel.exposed.assign(pixel.frames * pixel.knots, 0.0);
    for (int l = 0; l < pixel.frames; ++l) {
        const Frame& frame = pixel.exposures[l];
        for (int k = 0; k < pixel.knots; ++k) {
            const double from = k == 0 ? frame.start : std::max(pixel.t[k], frame.start);
            const double to = k + 1 == pixel.knots ? frame.end : std::min(pixel.t[k + 1], frame.end);
            pixel.exposed[l * pixel.knots + k] = std::sqrt(frame.weight) * pixel.gain * std::max(to - from, 0.0);
        }
    }
}

// gamma over dt at photocurrent i, and its slope by ln i.
struct Settling {
    double gamma, slope;
};

inline Settling settling(const Pixel& pixel, double dt, double i) {
    const double tau = pixel.tau_0 + pixel.alpha / i;
    const double gamma = -std::expm1(-dt / tau);
    return {gamma, (1.0 - gamma) * dt / tau * (pixel.alpha / i) / tau};
}

// What a point of the search needs for residuals and Jacobian; memory is reused.
struct Point {
    std::vector<double> photocurrent, gamma, slope_drive, by_u;

    // Fills `residuals` (rows()); returns whether all is finite.
    bool residuals(const Pixel& pixel, const double* u, double* residuals) {
        const int n = pixel.knots;
        for (auto* column : {&photocurrent, &gamma, &slope_drive, &by_u}) column->resize(n);
        for (int k = 0; k < n; ++k) photocurrent[k] = std::exp(u[k]);
        double voltage = u[0], sum = 0.0;
        for (int k = 1; k < n; ++k) {
            const Settling at = settling(pixel, pixel.t[k] - pixel.t[k - 1], photocurrent[pixel.tau_at_end ? k : k - 1]);
            const double drive = u[k] - voltage, step = at.gamma * drive;
            gamma[k] = at.gamma;
            slope_drive[k] = at.slope * drive;
            voltage += step;
            residuals[k - 1] = pixel.root_evs_weight * (pixel.steps[k] - step);
            sum += residuals[k - 1];
        }
        for (int l = 0; l < pixel.frames; ++l) {
            const Frame& frame = pixel.exposures[l];
            const double* exposed = &pixel.exposed[l * n];
            double dn = std::sqrt(frame.weight) * pixel.black;
            for (int k = 0; k < n; ++k) dn += exposed[k] * photocurrent[k];
            residuals[n - 1 + l] = std::sqrt(frame.weight) * frame.dn - dn;
            sum += dn;
        }
        return std::isfinite(sum);
    }

    // The Jacobian at the point of the last `residuals`, row by row.
    void jacobian_by_rows(const Pixel& pixel, double* jacobian) {
        const int n = pixel.knots;
        by_u[0] = 1.0;
        for (int k = 1; k < n; ++k, jacobian += n) {
            by_u[k] = 0.0;
            const double kept = 1.0 - gamma[k], towards = pixel.root_evs_weight * gamma[k];
            for (int j = 0; j < k; ++j) {
                jacobian[j] = towards * by_u[j];
                by_u[j] *= kept;
            }
            std::fill(jacobian + k, jacobian + n, 0.0);
            const int sets_tau = pixel.tau_at_end ? k : k - 1;
            by_u[k] += gamma[k];
            by_u[sets_tau] += slope_drive[k];
            jacobian[k] -= pixel.root_evs_weight * gamma[k];
            jacobian[sets_tau] -= pixel.root_evs_weight * slope_drive[k];
        }
        for (int l = 0; l < pixel.frames; ++l, jacobian += n)
            for (int k = 0; k < n; ++k) jacobian[k] = -pixel.exposed[l * n + k] * photocurrent[k];
    }

    // The same column by column.
    void jacobian_by_columns(const Pixel& pixel, double* jacobian) {
        const int n = pixel.knots;
        const double root = pixel.root_evs_weight;
        for (int j = 0; j < n; ++j, jacobian += pixel.rows()) {
            double by_u = j == 0 ? 1.0 : 0.0;
            std::fill(jacobian, jacobian + std::max(j - 1, 0), 0.0);
            for (int k = std::max(j, 1); k < n; ++k) {
                double step = -gamma[k] * by_u;
                if (k == j) step += gamma[k];
                if ((pixel.tau_at_end ? k : k - 1) == j) step += slope_drive[k];
                by_u += step;
                jacobian[k - 1] = -root * step;
            }
            for (int l = 0; l < pixel.frames; ++l) jacobian[n - 1 + l] = -pixel.exposed[l * n + j] * photocurrent[j];
        }
    }
};

// Seconds of processor that this process has used: of all its threads, and blind to the machine's other work.
inline double processor_s() {
    timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return now.tv_sec + 1e-9 * now.tv_nsec;
}

struct Timed {
    double setup_s = std::numeric_limits<double>::infinity();
    double solve_s = std::numeric_limits<double>::infinity();
    int iterations = 0;
    std::vector<double> u;
};

// Repeats `once` (which sets up, solves and writes its own times) as often as asked: by number and by seconds.
inline Timed fastest(int least, double seconds, const std::function<void(Timed&)>& once) {
    Timed best;
    const double begin = processor_s();
    for (int n = 0; n < 1000 && (n < least || processor_s() - begin < seconds); ++n) {
        Timed now;
        once(now);
        best.setup_s = std::min(best.setup_s, now.setup_s);
        best.solve_s = std::min(best.solve_s, now.solve_s);
        best.iterations = now.iterations;
        best.u = std::move(now.u);
    }
    return best;
}

inline void write(std::ostream& out, int index, const char* method, const Timed& timed) {
    out << index << ' ' << method << ' ' << timed.setup_s << ' ' << timed.solve_s << ' ' << timed.iterations;
    for (double u : timed.u) out << ' ' << u;
    out << '\n';
}

using Peer = std::function<Timed(Pixel&, int, double)>;

// Runs `solve` on every problem of the first file, into the second: index, method, set-up and solve in s, iterations, u.
inline int run(int argc, char** argv, const std::vector<std::pair<const char*, Peer>>& peers) {
    if (argc != 5) {
        std::cerr << "usage: " << argv[0] << " PROBLEMS RESULTS LEAST_REPEATS LEAST_SECONDS\n";
        return 2;
    }
    std::ifstream in(argv[1]);
    std::ofstream out(argv[2]);
    out.precision(17);
    Pixel pixel;
    for (int index = 0; read(in, pixel); ++index)
        for (const auto& [method, solve] : peers) write(out, index, method, solve(pixel, std::stoi(argv[3]), std::stod(argv[4])));
    return out.flush() ? 0 : 1;
}
