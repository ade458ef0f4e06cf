// Adaptive cruise control behind a car that brakes, in C++17 without a library: simulator or controller of
// avrare-process. Build: c++ -std=c++17 -O2 -ffp-contract=off -o acc acc.cpp
//
// Messages are flat objects of numbers, lists and words, so a search for a key reads them.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <map>
#include <string>
#include <vector>

using Row = std::vector<double>;

// Text after `"key":`, or null where the message lacks it.
const char *find(const std::string &line, const std::string &key) {
    const auto at = line.find('"' + key + "\":");
    return at == std::string::npos ? nullptr : line.c_str() + at + key.size() + 3;
}

// Numbers of a list, or of one of the lists in it, up to its bracket; moves on past it.
Row row(const char *&text) {
    Row numbers;
    while (*text && *text != '[') ++text;
    if (*text) ++text;
    while (*text && *text != ']') {
        char *end;
        const double number = std::strtod(text, &end);  // reads NaN and Infinity too
        if (end != text) numbers.push_back(number);
        text = end != text ? end : text + 1;
    }
    if (*text) ++text;
    return numbers;
}

// Rows of a list of N lists; N empty ones for null.
std::vector<Row> rows(const std::string &line, const std::string &key, std::size_t n) {
    std::vector<Row> table(n);
    const char *text = find(line, key);
    while (text && *text == ' ') ++text;
    if (!text || *text != '[') return table;
    ++text;
    for (auto &numbers : table) numbers = row(text);
    return table;
}

double option(const std::string &line, const std::string &key, double otherwise) {
    const char *text = find(line, key);
    return text ? std::strtod(text, nullptr) : otherwise;
}

// One world: gap to the car ahead [m], both speeds [m/s], error of the radar [m].
struct Road {
    double time = 0.0, gap = 40.0, speed = 25.0, lead = 25.0, error = 0.0;

    void step(double action, double noise, double radar) {
        speed = std::max(speed + 0.1 * action, 0.0);
        const double braking = time > 3.0 && time < 7.0 ? 6.0 : 0.0;
        lead = std::max(lead - 0.1 * braking, 0.0);
        gap += 0.1 * (lead - speed);
        error = 0.95 * error + radar * noise;
        time += 0.1;
    }
};

// Acceleration [m/s^2] from what is seen.
double cruise(const Row &seen, double time_gap) {
    const double gap = seen[0], speed = seen[1], lead = seen[2];
    return std::clamp(0.3 * (gap - 3.0 - time_gap * speed) + (lead - speed), -8.0, 2.0);
}

int main() {
    std::map<int, Road> worlds;
    std::string line;
    bool simulates = true;
    double radar = 1.0, time_gap = 1.3;
    while (std::getline(std::cin, line)) {
        const auto is = [&](const char *word) { return line.find(std::string("\"do\": \"") + word) != line.npos; };
        const auto list = [&](const char *key) {
            const char *text = find(line, key);
            return text ? row(text) : Row();
        };
        if (is("hello")) {
            simulates = line.find("\"role\": \"simulator\"") != line.npos;
            radar = option(line, "radar", radar);
            time_gap = option(line, "time_gap", time_gap);
            std::puts(simulates ? R"({"outputs": ["gap", "speed"], "noise": ["radar"], "dt": 0.1, "copy": true,)"
                                  R"( "seen": ["measured gap", "speed", "speed ahead"]})"
                                : R"({"outputs": ["acceleration"], "memory": false})");
        } else if (is("copy")) {
            const Row from = list("from"), to = list("to");
            for (std::size_t i = 0; i < from.size(); ++i) worlds[int(to[i])] = worlds[int(from[i])];
            std::puts("{}");
        } else if (is("reset") || is("step")) {
            const Row numbers = list("worlds");
            const auto inputs = rows(line, "inputs", numbers.size()), noise = rows(line, "noise", numbers.size());
            std::printf("{\"outputs\": [");
            for (std::size_t i = 0; i < numbers.size(); ++i) {
                if (i) std::printf(", ");
                Road &road = worlds[int(numbers[i])];
                if (!simulates) {
                    std::printf("[%.17g]", cruise(inputs[i], time_gap));
                    continue;
                }
                if (is("reset")) road = Road();
                else road.step(inputs[i].at(0), noise[i].at(0), radar);
                std::printf("[%.17g, %.17g, %.17g, %.17g, %.17g]", road.gap, road.speed, road.gap + road.error,
                            road.speed, road.lead);
            }
            std::puts("]}");
        } else {
            return 0;  // bye
        }
        std::fflush(stdout);
    }
}
