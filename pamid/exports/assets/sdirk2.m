function x = integrate(s, u, time, d, h)
% One step of the L-stable SDIRK2 (Alexander 1977) with the inputs and cells held.
share = 1 - sqrt(0.5);
x = newton(s, s.x, s.x, u, time, d, share * h);
k = (x - s.x) / (share * h);
x = newton(s, x, s.x + (1 - share) * h * k, u, time, d, share * h);
end

function x = newton(s, x, base, u, time, d, gh)
% Solves x = base + gh f(x) by damped Newton (Deuflhard 2004, section 3.3); NaN where it did not converge.
for turn = 1:40
    [f, J] = slopes(s, x, u, time, d);
    M = eye(numel(x)) - gh * J;
    r = M \ (base + gh * f - x);
    worst = max(abs(r) ./ (1e-6 + abs(x)));
    before = x;
    x = before + r;
    reach = 1;
    for halving = 1:20
        if worst <= 1e-3
            break
        end
        x = before + reach * r;
        q = M \ (base + gh * rates(s, x, u, time, d) - x);
        if max(abs(q) ./ (1e-6 + abs(before))) <= (1 - 0.25 * reach) * worst
            break
        end
        reach = 0.5 * reach;
    end
    if worst < 1e-9
        return
    end
end
x = NaN(size(x));
end
