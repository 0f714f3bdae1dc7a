function [centers, covariances, ots_from_ct] = read_ronnaplan(fiducials_file, registration_file)
%READ_RONNAPLAN  Marker centers (N x 3, LPS mm), covariances (3 x 3 x N, mm^2), and the transform (4 x 4, mm).
    found = jsondecode(fileread(fiducials_file));
    assert(strcmp(found.format, 'ronnaplan.fiducials') && found.version == 1, 'not a fiducials.json of version 1');
    assert(strcmp(found.coordinate_system, 'LPS') && strcmp(found.unit, 'mm'), 'expected LPS and mm');
    markers = found.fiducials;
    if isstruct(markers), markers = num2cell(markers); end   % jsondecode: a cell array where optional fields differ
    centers = zeros(numel(markers), 3);
    covariances = zeros(3, 3, numel(markers));
    for n = 1:numel(markers)
        centers(n, :) = markers{n}.center;
        covariances(:, :, n) = markers{n}.covariance;
    end
    ots_from_ct = [];
    if nargin > 1
        registration = jsondecode(fileread(registration_file));
        assert(strcmp(registration.status, 'unique'), 'the pairing was refused: there is no transform');
        ots_from_ct = registration.ots_from_ct;
    end
end
