function x = integrate(s, u, time, d, h)
% One Runge-Kutta step of order 4 with the inputs and cells held.
weight = [h / 6, h / 3, h / 3, h / 6];
reach = [0.5 * h, 0.5 * h, h, h];
x = s.x;
total = zeros(size(x));
for stage = 1:4
    f = rates(s, x, u, time, d);
    total = total + weight(stage) * f;
    x = s.x + reach(stage) * f;
end
x = s.x + total;
end
